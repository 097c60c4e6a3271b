"""Predicted error probabilities and distances beside the truth, and the receiver beside one that knows the channel."""
