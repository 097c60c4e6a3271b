"""The command: a thin face over `link`, `measure`, `sweeps` and `experiments`."""
