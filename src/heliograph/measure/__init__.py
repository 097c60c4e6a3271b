"""Measurement: error counts and rates with intervals, and a link bench that needs no files."""
