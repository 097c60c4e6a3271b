"""The whole link: transmitters, channel and receiver composed, films with their truth, errors counted."""
