"""Training data: simulated films with truth, cut-outs, splits and a datasheet."""
