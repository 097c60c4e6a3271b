"""Films with time gaps, as from a camera that pauses while the array keeps transmitting."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame

Gap = tuple[int, float]
"""First frame after the gap, and gap length in s."""


def random_gaps(rng: np.random.Generator, frames: int, shortest_s: float, longest_s: float) -> list[Gap]:
    """Draw one to three gaps; half of the draws have a gap in the first 20 frames."""
    places = rng.integers(1, frames, rng.integers(1, 4))
    if rng.random() < 0.5:
        places[0] = rng.integers(1, 20)
    lengths = np.exp(rng.uniform(np.log(shortest_s), np.log(longest_s), len(places)))
    return sorted(zip(places.tolist(), lengths.tolist(), strict=True))


def gapped(
    frames: Sequence[Frame], gaps: Sequence[Gap], packet_s: float, numbered: bool
) -> tuple[list[Frame], NDArray[np.float64]]:
    """Return the remaining frames and the delay in s of each original frame (NaN if removed).

    A gap delays later frames by complete packets and removes frames for the remainder, so the transmission continues.
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
    """Return start times of packets with all frames present and no gap inside."""
    times, starts = np.array([frame.time_s for frame in frames]), list[float]()
    for start in np.arange(first_s, times[-1] + 1e-9 - 0.95 * packet_s, packet_s):
        inside = late[(times >= start - 1e-9) & (times < start + packet_s - 1e-9)]
        if np.isfinite(inside).all() and np.ptp(inside) == 0:
            starts.append(float(start + inside[0]))
    return starts
