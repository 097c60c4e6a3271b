"""A word on what a film shows: its frames, its light, its noise, what blinks in it, and why that is or is no array."""

from heliograph.probe.causes import Cause, RegionSeen
from heliograph.probe.film import Findings, probe_film

__all__ = ["Cause", "Findings", "RegionSeen", "probe_film"]
