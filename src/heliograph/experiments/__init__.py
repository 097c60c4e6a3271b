"""Experiments on the link and their reports."""
