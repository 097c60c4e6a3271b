"""Screen patterns without a browser, drawn as on page *Transmit*."""

import numpy as np
from screen_films import GAMMA, Grabs

from heliograph.web.sending import Sending

MARGIN = 2  # dark margin in cells, as on the page


def shown(sending: Sending, seconds: float, cell_px: int = 16, first_s: float = 0.3) -> Grabs:
    """Return grabs of a transmission for some seconds."""
    count = int(seconds * sending.rate_hz) + 1
    levels = sending.packets(0, -(-count // sending.packet_patterns))[:count]
    pixels = np.rint(255 * (levels / 4) ** (1 / GAMMA)).astype(np.uint8)
    pictures = np.pad(pixels, ((0, 0), (MARGIN, MARGIN), (MARGIN, MARGIN)))
    pictures = pictures.repeat(cell_px, axis=1).repeat(cell_px, axis=2)
    return Grabs(first_s + np.arange(count) / sending.rate_hz, pictures)
