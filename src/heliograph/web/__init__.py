"""Web pages that show a reception, transmit by a screen, and receive films of a phone."""
