"""Data sent by an LED array, received by a high-speed camera on a moving car."""
