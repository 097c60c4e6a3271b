"""A reception that is watched: its source, its controls, and what a page sees of it."""
