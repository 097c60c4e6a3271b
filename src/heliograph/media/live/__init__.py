"""Live cameras as films: industrial ones by Aravis or GenICam producers, webcams, and cameras of one's own by name."""
