"""Experiments with the link, and reports of them."""
