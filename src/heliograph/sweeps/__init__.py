"""Sweeps: error rates over a grid of settings, resumable, on a machine or a cluster."""
