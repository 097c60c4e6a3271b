"""What the light says: the whole contract between both ends, without images.

bytes -> frame (header, CRC-32) -> turbo code -> Haar patterns -> PWM slots, and back.
"""
