"""Flicker of the whole array by the measures of IEEE 1789, CIE TN 006 and IEEE 802.15.7."""
