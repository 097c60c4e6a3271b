"""Demonstration: a simulated and received drive with a report."""
