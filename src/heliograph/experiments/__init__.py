"""Experiments on the link, with a report."""
