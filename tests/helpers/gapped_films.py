"""Films with gaps in time, as a camera that pauses makes them while the light goes on."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame

Gap = tuple[int, float]
"""Number of the first frame after the gap, and its length in s."""


def random_gaps(rng: np.random.Generator, frames: int, shortest_s: float, longest_s: float) -> list[Gap]:
    """One to three gaps anywhere in a film, half of the time one within its first frames."""
    places = rng.integers(1, frames, rng.integers(1, 4))
    if rng.random() < 0.5:
        places[0] = rng.integers(1, 20)
    lengths = np.exp(rng.uniform(np.log(shortest_s), np.log(longest_s), len(places)))
    return sorted(zip(places.tolist(), lengths.tolist(), strict=True))


def gapped(
    frames: Sequence[Frame], gaps: Sequence[Gap], packet_s: float, numbered: bool
) -> tuple[list[Frame], NDArray[np.float64]]:
    """Frames left by gaps, and of each original frame how much later it comes; NaN of one that is missing.

    Whole packets of a gap are added to the time, and the frames of the rest are missing, so the light goes on.
    """
    period_s = float(np.median(np.diff([frame.time_s for frame in frames])))
    late = np.zeros(len(frames))
    for place, length_s in gaps:
        packets = int(length_s / packet_s)
        late[place:] += packets * packet_s
        late[place : place + round((length_s - packets * packet_s) / period_s)] = np.nan
    left = [(frame, shift) for frame, shift in zip(frames, late, strict=True) if np.isfinite(shift)]
    numbers = [frame.index + round(shift / period_s) if numbered else k for k, (frame, shift) in enumerate(left)]
    film = [
        replace(frame, index=k, time_s=frame.time_s + shift) for k, (frame, shift) in zip(numbers, left, strict=True)
    ]
    return film, late


def whole_packets(frames: Sequence[Frame], late: NDArray[np.float64], first_s: float, packet_s: float) -> list[float]:
    """Times at which packets begin whose frames are all there, without a gap between them."""
    times, starts = np.array([frame.time_s for frame in frames]), list[float]()
    for start in np.arange(first_s, times[-1] + 1e-9 - 0.95 * packet_s, packet_s):
        inside = late[(times >= start - 1e-9) & (times < start + packet_s - 1e-9)]
        if np.isfinite(inside).all() and np.ptp(inside) == 0:
            starts.append(float(start + inside[0]))
    return starts
