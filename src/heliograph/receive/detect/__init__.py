"""Which arrays are in sight, where, when their headers begin, and which format the headers signal."""
