"""Cut-outs read as the plain receiver reads frames: where LEDs are resolved, this is all it takes."""

from collections.abc import Sequence

import numpy as np

from heliograph.receive.decode.codeword import Decoding, decode_packet
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.packets import Words
from heliograph.receive.plain.extract import at_leds
from heliograph.signal.packet import PacketFormat


def read_led_by_led(
    cutouts: Sequence[Cutout | None], form: PacketFormat, identity: int, options: Decoding
) -> Words | None:
    """Codewords by the luminance at each LED's position alone, as the paper reads them.

    It knows of no blur, no neighbours and no LED that is hidden, so nothing of that can mislead it.
    """
    shown = [cutout for cutout in cutouts if cutout is not None]
    if form.single or not shown or any(cutout.combination is not None for cutout in shown):
        return None
    side = form.settings.side
    luminances = np.zeros((len(cutouts), side, side))
    for place, cutout in enumerate(cutouts):
        if cutout is not None:
            luminances[place] = at_leds(cutout.difference, cutout.corner, cutout.middle, side)
    seen = np.array([cutout is not None for cutout in cutouts])
    return decode_packet(luminances, seen, form, identity, options)
