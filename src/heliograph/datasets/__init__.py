"""Data sets of simulated films with their truth and cut-outs, for those who train detectors and decoders."""
