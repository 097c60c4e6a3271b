"""Reception and speed benchmarks: `python -m benchmarks.behaviour` and `make bench`."""
