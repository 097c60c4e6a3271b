"""Calibration of the soft receiver, and the loss by channel estimation."""
