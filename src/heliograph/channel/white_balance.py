"""Automatic white balance as gray frames show it: coloured light grows brighter and darker.

A camera multiplies red and blue by gains of its own, takes all three to the power of 1 / gamma, and a film's luma is
their weighted sum. Of light of one colour, so much of each primary, that is

    Y(t) = (w_r (a_r(t) c_r)^(1/gamma) + w_g c_g^(1/gamma) + w_b (a_b(t) c_b)^(1/gamma)) L^(1/gamma),

which is the light L times a gain: that of the colour, and of the time.
"""

import math

from heliograph.channel.devices import CameraSettings, Colour
from heliograph.channel.settings import ChannelSettings

LUMA = (0.2126, 0.7152, 0.0722)
"""Weights of red, green and blue in luma (Rec. ITU-R BT.709)."""


def luma_gain(camera: CameraSettings, gamma: float, colour: Colour, time_s: float) -> float:
    """Return the factor by which white balance changes the light of a colour, 1 without a swing."""
    if not camera.white_balance_swing:
        return 1.0
    swing = camera.white_balance_swing * math.sin(2 * math.pi * time_s / camera.white_balance_period_s)
    gains = (1 + swing, 1.0, 1 - swing)
    luma = sum(w * (a * c) ** (1 / gamma) for w, a, c in zip(LUMA, gains, colour, strict=True))
    usual = sum(w * c ** (1 / gamma) for w, c in zip(LUMA, colour, strict=True))
    return (luma / usual) ** gamma


def surroundings_gain(settings: ChannelSettings, time_s: float) -> float:
    """Return the factor by which white balance changes the light of background and panels."""
    return luma_gain(settings.camera, settings.sensor.gamma, settings.background.colour, time_s)


def array_gain(settings: ChannelSettings, time_s: float) -> float:
    """Return the factor by which white balance changes the light of arrays, by that of their surroundings."""
    own = luma_gain(settings.camera, settings.sensor.gamma, settings.emitter.colour, time_s)
    return own / surroundings_gain(settings, time_s)
