"""Points of a sweep whose arrays are too small or too large in the image to be looked for."""

from collections.abc import Sequence

from heliograph.link.settings import LinkSettings
from heliograph.receive.detect.alternation import size_limits
from heliograph.receive.registry import RECEIVERS
from heliograph.sweeps.points import Point

NAMED = 3
"""Points that a warning names; the others are counted."""


def not_looked_for(points: Sequence[Point]) -> str:
    """A line about the points whose arrays no receiver looks for; empty where there are none."""
    found = [(point, text) for point in points if (text := _outside(point.settings))]
    if not found:
        return ""
    named = "; ".join(f"{point.text}: {text}" for point, text in found[:NAMED])
    more = f"; and {len(found) - NAMED} more" if len(found) > NAMED else ""
    return (
        f"{len(found)} of {len(points)} points have an array that is not looked for ({named}{more}); change "
        "receive.detect.min_side_px or max_side_px, or the distance"
    )


def sides_px(settings: LinkSettings) -> list[tuple[float, float]]:
    """Smallest and largest side of the arrays' images in px, over the way from the first distance to the last."""
    channel = settings.channel
    length = settings.signal.side * channel.emitter.pitch_m * channel.camera.focal_px
    ways = (channel.distance_m, channel.stop_m) if channel.moves else (channel.distance_m,)
    places = [[way + array.z_offset_m for way in ways] for array in channel.arrays if not array.vz_m_s]
    return [(length / max(way), length / min(way)) for way in places if min(way) > 0]


def _outside(settings: LinkSettings) -> str:
    """The array that the receiver never looks for, and what it looks for; empty where there is none."""
    receive = settings.receive
    if not RECEIVERS.is_built_in(receive.receiver):
        return ""  # it may look for what it likes
    smallest, largest = receive.smallest_side_px, receive.detect.max_side_px
    lowest, highest = size_limits(smallest, largest)
    for least, most in sides_px(settings):
        if most < lowest or least > highest:
            return f"{most:.3g} px a side, looked for are {smallest:g} to {largest:g} px"
    return ""
