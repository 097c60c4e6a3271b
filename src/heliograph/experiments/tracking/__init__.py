"""Trackers of an array compared: all start from one detection and see the same frames."""
