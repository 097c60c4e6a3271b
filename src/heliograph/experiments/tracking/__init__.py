"""Comparison of trackers from the same detection on the same frames."""
