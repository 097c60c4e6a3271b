"""Errors, camera frames, checked settings and safe file writing, used by all other packages."""
