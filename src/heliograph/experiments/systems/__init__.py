"""Error rates of other systems in the same channel."""
