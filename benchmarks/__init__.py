"""Codewords received and speed: `python -m benchmarks.behaviour` and `make bench`."""
