"""Decoding of packets: samples at the LEDs, or iterations between equaliser and decoder."""
