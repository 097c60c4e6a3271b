"""The receiver "screen": a screen filmed from near by a phone, row by row, with many pixels a cell."""
