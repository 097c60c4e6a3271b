"""Diagnosis of films: frames, light and noise, and the causes of a failed reception."""

from heliograph.probe.causes import Cause, RegionReport
from heliograph.probe.film import Findings, probe_film

__all__ = ["Cause", "Findings", "RegionReport", "probe_film"]
