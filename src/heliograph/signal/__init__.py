"""The signal of the light: everything that transmitter and receiver agree on, without images.

bytes -> blocks (header, CRC-32) -> turbo code -> data matrices -> Haar patterns -> PWM slots, and back. The document
docs/air-interface.md defines all of it; "section" means one of its sections.
"""
