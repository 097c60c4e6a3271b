"""Fountain codes for files: any sufficient set of symbols reconstructs the file (sections 7.1 and 8.1)."""
