"""Trackers of an array to be compared: all start from one detection and see the same frames."""

from heliograph.experiments.trackers.follow import Follower, InvertedSignals, Still
from heliograph.experiments.trackers.image import BackgroundMotion, MultipleInstance, TemplateMatch
from heliograph.experiments.trackers.known import KnownPattern

__all__ = [
    "BackgroundMotion",
    "Follower",
    "InvertedSignals",
    "KnownPattern",
    "MultipleInstance",
    "Still",
    "TemplateMatch",
]
