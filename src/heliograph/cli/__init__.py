"""The command: a thin face over `heliograph.link` and `heliograph.experiments`."""
