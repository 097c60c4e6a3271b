"""Panels of LEDs with any content: `locate`, `follow`, `sample`, `unmix_colours`."""

from heliograph.panel.colours import UnmixedColours, unmix_colours
from heliograph.panel.panels import follow, locate, sample
from heliograph.panel.place import Place

__all__ = ["Place", "UnmixedColours", "follow", "locate", "sample", "unmix_colours"]
