"""Signal format shared by transmitter and receiver, independent of images.

bytes -> blocks (header, CRC-32) -> turbo code -> data matrices -> Haar patterns -> PWM slots, and back.
docs/air-interface.md defines the signal; "section" refers to this document.
"""
