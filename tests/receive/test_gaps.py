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

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.receive import Packet, make_receiver
from heliograph.web.sending import screen_settings, sending_of

ENDLESS_S = 1e6
"""A gap of eleven days, as after a clock change."""


@cache
def arrays_film() -> tuple[LinkSettings, list[Frame]]:
    settings = link("signal.data_pairs=24", distance_m=30.0)
    return settings, film(settings, 52 * 5 + 20, 3, 12)


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


def lacking(packets: Sequence[Packet], starts: Sequence[float], packet_s: float) -> list[float]:
    """Return start times of undecoded packets."""
    read = [packet.start_time_s for packet in packets if packet.status == "ok"]
    return [start for start in starts if not any(abs(one - start) < 0.1 * packet_s for one in read)]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("receiver", ["plain", "soft"])
def test_whole_packets_between_gaps_are_read(receiver: str, seed: int) -> None:
    (settings, frames), rng = arrays_film(), np.random.default_rng(seed)
    packet_s = settings.signal.packet_s
    gaps = random_gaps(rng, len(frames), 0.0011, 0.1) if seed % 2 else random_gaps(rng, len(frames), 0.01, 60.0)
    gaps = [(gaps[0][0], ENDLESS_S), *gaps[1:]] if seed == 0 else gaps
    left, late = gapped(frames, gaps, packet_s, numbered=bool(rng.integers(2)))
    starts = whole_packets(frames, late, 0.0, packet_s)
    assert lacking(received(settings, receiver, left), starts, packet_s) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_whole_packets_of_a_screen_between_gaps_are_read(seed: int) -> None:
    (settings, frames), rng = screens_film(), np.random.default_rng(seed)
    packet_s = settings.signal.packet_s
    gaps = random_gaps(rng, len(frames), 0.03, 60.0)
    gaps = [(gaps[0][0], ENDLESS_S), *gaps[1:]] if seed == 0 else gaps
    left, late = gapped(frames, gaps, packet_s, numbered=bool(rng.integers(2)))
    starts = whole_packets(frames, late, -0.031, packet_s)
    assert lacking(received(settings, "screen", left), starts, packet_s) == []


@pytest.mark.slow
@pytest.mark.parametrize("gap_s", [0.9, 7.0, 12.0])
def test_a_gap_while_a_screen_is_followed_loses_one_packet(gap_s: float) -> None:
    """The light pauses too, so its phase jumps."""
    settings, frames = screens_film()
    late = [replace(one, time_s=one.time_s + gap_s * (one.index >= 100)) for one in frames]
    packets = received(settings, "screen", late)
    assert packets[0].status == "ok"
    assert sum(one.status == "ok" and one.start_time_s > frames[100].time_s + gap_s for one in packets) >= 1


@pytest.mark.slow
def test_a_camera_that_stands_still_is_a_gap() -> None:
    """Repeat one frame for a minute of timestamps."""
    settings, frames = screens_film()
    copies = [replace(frames[99], index=99 + k, time_s=frames[99].time_s + k / 30) for k in range(1, 1800)]
    after = [replace(one, index=one.index + 1800, time_s=one.time_s + 60.0) for one in frames[100:]]
    packets = received(settings, "screen", [*frames[:100], *copies, *after])
    assert [one.status for one in packets if one.start_time_s > 60.0].count("ok") >= 2


@pytest.mark.parametrize("receiver", ["plain", "soft", "screen"])
@pytest.mark.parametrize("back_s", [0.0, 0.5])
def test_time_that_does_not_go_on_is_refused_and_the_next_frame_is_taken(receiver: str, back_s: float) -> None:
    settings, frames = screens_film() if receiver == "screen" else arrays_film()
    live = make_receiver(settings.signal, replace(settings.receive, receiver=receiver))
    period_s = frames[1].time_s - frames[0].time_s
    for frame in frames[:3]:
        list(live.push(frame))
    with pytest.raises(HeliographError, match="must follow in time") as caught:
        list(live.push(replace(frames[3], time_s=frames[2].time_s - back_s * period_s)))
    assert "\n" not in str(caught.value)
    for frame in frames[3:6]:
        list(live.push(frame))


@pytest.mark.parametrize("receiver", ["soft", "screen"])
def test_numbers_may_jump(receiver: str) -> None:
    settings, frames = screens_film() if receiver == "screen" else arrays_film()
    numbers = [0, 1, 2, 1 << 40, (1 << 40) + 1, 5, 6]
    assert received(settings, receiver, [replace(one, index=k) for one, k in zip(frames, numbers, strict=False)]) == []
