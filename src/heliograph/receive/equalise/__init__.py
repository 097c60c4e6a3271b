"""Symbols from the statistics of pairs: linear MMSE, expectation propagation, gains of LEDs, polarities."""
