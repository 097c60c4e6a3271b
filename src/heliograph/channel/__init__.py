"""Physical channel, equations (1) to (6) of Nagura et al. 2010: LED patterns -> camera frames and separate truth.

exposure (PWM slots within the shutter) -> scene and motion (pinhole, vehicle) -> background -> optics (panel, disc,
lobe, blur, pixels) -> sensor (EMVA 1288) -> transfer (lost and repeated frames).
"""

from heliograph.channel.background import Footage
from heliograph.channel.camera import film, frame_count
from heliograph.channel.motion import ImuTrace, film_duration
from heliograph.channel.settings import ChannelSettings, Placement
from heliograph.channel.truth import ArrayTruth, NoiseModel, Truth

__all__ = [
    "ArrayTruth",
    "ChannelSettings",
    "Footage",
    "ImuTrace",
    "NoiseModel",
    "Placement",
    "Truth",
    "film",
    "film_duration",
    "frame_count",
]
