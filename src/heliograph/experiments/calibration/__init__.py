"""Predicted error probabilities and distances beside the truth, and the receiver beside one with the true channel."""
