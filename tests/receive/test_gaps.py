"""Time gaps between frames: reception resumes with the next packet."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gapped_films import gapped, random_gaps, whole_packets
from scenes import film, link
from screen_films import Phone, phone_frames
from screen_light import shown

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.receive import Packet, make_receiver
from heliograph.web.sending import screen_settings, sending_of


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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("receiver", "seed"),
    [*(("plain", seed) for seed in range(4)), ("soft", 0), ("soft", 1), ("screen", 0)],
)
def test_complete_packets_between_gaps_are_read(receiver: str, seed: int) -> None:
    settings, frames = screens_film() if receiver == "screen" else arrays_film()
    rng, packet_s = np.random.default_rng(seed), settings.signal.packet_s
    # the shortest gap is a frame
    shortest_s, longest_s = (0.03, 60.0) if receiver == "screen" else (0.0011, 0.1) if seed % 2 else (0.01, 60.0)
    gaps = random_gaps(rng, len(frames), shortest_s, longest_s)
    if seed == 0:
        # eleven days, as after a clock change
        gaps[0] = gaps[0][0], 1e6
    left, late = gapped(frames, gaps, packet_s, numbered=bool(rng.integers(2)))
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
    assert sum(packet.status == "ok" and packet.start_time_s > frames[100].time_s + gap_s for packet in packets) >= 1


@pytest.mark.slow
def test_repeated_frames_are_a_gap() -> None:
    """Repeat one frame for a minute of timestamps."""
    settings, frames = screens_film()
    copies = [replace(frames[99], index=99 + k, time_s=frames[99].time_s + k / 30) for k in range(1, 1800)]
    after = [replace(frame, index=frame.index + 1800, time_s=frame.time_s + 60.0) for frame in frames[100:]]
    packets = received(settings, "screen", [*frames[:100], *copies, *after])
    assert [packet.status for packet in packets if packet.start_time_s > 60.0].count("ok") >= 2


@pytest.mark.parametrize("receiver", ["soft", "screen"])
def test_frame_numbers_may_jump(receiver: str) -> None:
    settings, frames = screens_film() if receiver == "screen" else arrays_film()
    numbers = [0, 1, 2, 1 << 40, (1 << 40) + 1, 5, 6]
    renumbered = [replace(frame, index=k) for frame, k in zip(frames, numbers, strict=False)]
    assert received(settings, receiver, renumbered) == []
