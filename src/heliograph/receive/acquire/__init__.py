"""Which arrays are in sight, where, when their headers begin, and what format the headers signal."""
