"""Live cameras as films: industrial cameras by Aravis or GenICam producers, webcams, and user-defined cameras."""
