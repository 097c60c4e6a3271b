"""The demonstration: a drive filmed, received and shown."""
