"""The paper's own reading: the luminance at each LED's image position, one decoding a packet."""
