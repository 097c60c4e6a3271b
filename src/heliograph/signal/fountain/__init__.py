"""Whole files: a file cut into symbols, of which any that are enough give it back (sections 7.1 and 8.1)."""
