"""Flicker of the light of an array."""
