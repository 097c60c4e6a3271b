"""Experiments on single patterns and packets, and on the parameters of the paper."""
