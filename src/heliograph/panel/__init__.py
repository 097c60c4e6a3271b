"""Any panel of LEDs, without this project's packets: `locate`, `follow` and `sample`; a place is a homography."""

from heliograph.panel.panels import follow, locate, sample
from heliograph.panel.place import Place

__all__ = ["Place", "follow", "locate", "sample"]
