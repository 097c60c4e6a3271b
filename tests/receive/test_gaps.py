"""Time gaps between frames: reception resumes with the next packet."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scenes import Floats, film, link
from screen_films import Phone, phone_frames
from screen_light import shown

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.receive.api import make_receiver
from heliograph.receive.packet import Packet
from heliograph.web.sending import screen_settings, sending_of

Gap = tuple[int, float]  # first frame after the gap, and gap length in s


@cache
def arrays_film() -> tuple[LinkSettings, list[Frame]]:
    settings = link("signal.data_pairs=24", distance_m=30.0)
    return settings, film(settings, 52 * 4 + 20, 3, 12)


@cache
def screens_film() -> tuple[LinkSettings, list[Frame]]:
    settings = screen_settings(8, 15.0)
    grabs = shown(sending_of(b"Hello from a laptop", None, 8, 15.0), 10.2, cell_px=8)
    seen = phone_frames(grabs, Phone(width=120, height=100, side_px=64.0, blur_px=0.8, seed=5))
    return settings, [Frame(k, time_s, pixels) for k, (time_s, pixels) in enumerate(seen)]


def received(settings: LinkSettings, receiver: str, frames: Sequence[Frame]) -> list[Packet]:
    """Return packets from a receiver with live limits."""
    live = make_receiver(settings.signal, replace(settings.receive, receiver=receiver).with_live_limits())
    return [packet for frame in frames for packet in live.push(frame)] + list(live.finish())


def gapped(frames: Sequence[Frame], gaps: Sequence[Gap], packet_s: float, numbered: bool) -> tuple[list[Frame], Floats]:
    """Return the remaining frames and the delay in s of each original frame (NaN if removed).

    A gap delays later frames by complete packets and removes frames for the remainder, so the transmission continues.
    """
    period_s = float(np.median(np.diff([frame.time_s for frame in frames])))
    late = np.zeros(len(frames))
    for place, length_s in gaps:
        packets, rest_s = divmod(length_s, packet_s)
        late[place:] += packets * packet_s
        late[place : place + round(rest_s / period_s)] = np.nan
    left = [(frame, shift) for frame, shift in zip(frames, late, strict=True) if np.isfinite(shift)]
    numbers = [frame.index + round(shift / period_s) if numbered else k for k, (frame, shift) in enumerate(left)]
    moved = zip(numbers, left, strict=True)
    return [replace(frame, index=k, time_s=frame.time_s + shift) for k, (frame, shift) in moved], late


def whole_packets(frames: Sequence[Frame], late: Floats, first_s: float, packet_s: float) -> list[float]:
    """Return start times of packets with all frames present and no gap inside."""
    times, starts = np.array([frame.time_s for frame in frames]), list[float]()
    for start in np.arange(first_s, times[-1] + 1e-9 - 0.95 * packet_s, packet_s):
        inside = late[(times >= start - 1e-9) & (times < start + packet_s - 1e-9)]
        if np.isfinite(inside).all() and np.ptp(inside) == 0:
            starts.append(float(start + inside[0]))
    return starts


def random_gaps(seed: int, frames: int) -> list[Gap]:
    """Draw one to three gaps of 0.5 s to 60 s anywhere in a film."""
    rng = np.random.default_rng(seed)
    places = rng.integers(1, frames, rng.integers(1, 4))
    lengths = np.exp(rng.uniform(np.log(0.5), np.log(60.0), len(places)))
    return sorted(zip(places.tolist(), lengths.tolist(), strict=True))


@pytest.mark.slow
@pytest.mark.parametrize(("receiver", "gaps", "numbered"), [
    # eleven days, as after a clock change
    ("plain", [(7, 1e6), (120, 0.0211)], True),
    # a frame
    ("plain", [(60, 0.0011), (131, 0.0211)], False),
    ("soft", [(60, 0.0011), (140, 37.0)], True), ("screen", [(40, 1e6), (150, 2.7)], False),
    ("screen", [(100, 7.0)], False), *(("screen", random_gaps(seed, 300), False) for seed in (1, 2, 3)),
])  # fmt: skip
def test_complete_packets_between_gaps_are_read(receiver: str, gaps: Sequence[Gap], numbered: bool) -> None:
    settings, frames = screens_film() if receiver == "screen" else arrays_film()
    packet_s = settings.signal.packet_s
    left, late = gapped(frames, gaps, packet_s, numbered)
    starts = whole_packets(frames, late, -0.031 if receiver == "screen" else 0.0, packet_s)
    read = [packet.start_time_s for packet in received(settings, receiver, left) if packet.status == "ok"]
    assert [start for start in starts if not np.isclose(read, start, rtol=0, atol=0.1 * packet_s).any()] == []


@pytest.mark.slow
def test_gap_while_tracking_a_screen_loses_one_packet() -> None:
    """The light pauses too, so its phase jumps."""
    (settings, frames), gap_s = screens_film(), 0.9
    late = [replace(frame, time_s=frame.time_s + gap_s * (frame.index >= 100)) for frame in frames]
    packets = received(settings, "screen", late)
    assert packets[0].status == "ok"
    assert any(packet.status == "ok" and packet.start_time_s > frames[100].time_s + gap_s for packet in packets)


@pytest.mark.slow
def test_repeated_frames_are_a_gap() -> None:
    settings, frames = screens_film()
    copies = [replace(frames[99], index=99 + k, time_s=frames[99].time_s + k / 30) for k in range(1, 300)]
    after = [replace(frame, index=frame.index + 300, time_s=frame.time_s + 10.0) for frame in frames[100:]]
    packets = received(settings, "screen", [*frames[:100], *copies, *after])
    assert [packet.status for packet in packets if packet.start_time_s > 10.0].count("ok") >= 2


@pytest.mark.parametrize("receiver", ["soft", "screen"])
def test_frame_numbers_may_jump(receiver: str) -> None:
    settings, frames = screens_film() if receiver == "screen" else arrays_film()
    numbers = [0, 1, 2, 1 << 40, (1 << 40) + 1, 5, 6]
    renumbered = [replace(frame, index=k) for frame, k in zip(frames, numbers, strict=False)]
    assert received(settings, receiver, renumbered) == []
