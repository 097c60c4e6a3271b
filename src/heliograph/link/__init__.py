"""The whole link: transmitters, channel and receiver composed, and films with their truth."""
