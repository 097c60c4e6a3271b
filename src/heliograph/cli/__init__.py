"""Command line interface of `link`, `measure`, `sweeps` and `experiments`."""
