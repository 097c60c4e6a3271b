"""The pages in a browser: they show what the receiver does, send by a screen, and take films of a phone."""
