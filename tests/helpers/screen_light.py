"""A screen's patterns without a browser: grabs of the canvas as page *Transmit* draws it."""

import numpy as np
from screen_films import GAMMA, Grabs

from heliograph.web.sending import Sending

MARGIN = 2
"""Cells of dark margin, as the page's."""


def shown(sending: Sending, seconds: float, cell_px: int = 16, first_s: float = 0.3) -> Grabs:
    """What a screen shows of a sending for some seconds."""
    count = int(seconds * sending.rate_hz) + 1
    levels = sending.packets(0, -(-count // sending.packet_patterns))[:count]
    pixels = np.rint(255 * (levels / 4) ** (1 / GAMMA)).astype(np.uint8)
    pictures = np.pad(pixels, ((0, 0), (MARGIN, MARGIN), (MARGIN, MARGIN)))
    pictures = pictures.repeat(cell_px, axis=1).repeat(cell_px, axis=2)
    return Grabs(first_s + np.arange(count) / sending.rate_hz, pictures)
