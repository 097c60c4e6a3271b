"""Observation of the symbols in a pair of frames: cut-outs, noise and sufficient statistics."""
