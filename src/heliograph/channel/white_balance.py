"""Automatic white balance in gray frames: the brightness of coloured light varies.

A camera applies gains to red and blue and a power of 1 / gamma to all primaries. The luma of a film is the weighted sum

    Y(t) = (w_r (a_r(t) c_r)^(1/gamma) + w_g c_g^(1/gamma) + w_b (a_b(t) c_b)^(1/gamma)) L^(1/gamma),

the light L times a gain that depends on colour and time.
"""

import math

from heliograph.channel.settings import CameraSettings, ChannelSettings, Colour


def luma_gain(camera: CameraSettings, gamma: float, colour: Colour, time_s: float) -> float:
    """Return the factor of white balance on the light of a colour, 1 for a constant balance."""
    if not camera.white_balance_swing:
        return 1.0
    swing = camera.white_balance_swing * math.sin(2 * math.pi * time_s / camera.white_balance_period_s)
    gains = (1 + swing, 1.0, 1 - swing)
    weights = (0.2126, 0.7152, 0.0722)  # of red, green and blue in luma (Rec. ITU-R BT.709)
    luma = sum(w * (a * c) ** (1 / gamma) for w, a, c in zip(weights, gains, colour, strict=True))
    reference = sum(w * c ** (1 / gamma) for w, c in zip(weights, colour, strict=True))
    return (luma / reference) ** gamma


def surroundings_gain(settings: ChannelSettings, time_s: float) -> float:
    """Return the factor of white balance on the light of background and panels."""
    return luma_gain(settings.camera, settings.sensor.gamma, settings.background.colour, time_s)


def array_gain(settings: ChannelSettings, time_s: float) -> float:
    """Return the factor of white balance on the light of arrays relative to the surroundings."""
    gain = luma_gain(settings.camera, settings.sensor.gamma, settings.emitter.colour, time_s)
    return gain / surroundings_gain(settings, time_s)
