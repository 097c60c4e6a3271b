"""Packet reader of the soft receiver: pose times for data, and LEDs mistaken for dead."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from recorder import Recorder
from scenes import SIDE, drawn_film, film, link

from heliograph.receive import receive_frames
from heliograph.receive.decode.header_reader import HeaderReader
from heliograph.receive.equalise.led_gains import DecodedPair, LedGains
from heliograph.receive.events import DecodeEvent, ExtractEvent
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.observe.statistics import PairStatistics
from heliograph.signal.settings import SignalSettings

Floats = NDArray[np.float64]


@pytest.mark.parametrize(("order", "centroid"), [((2, 0, 1, 3), 0.375), ((0, 1, 2, 3), 0.5), ((0, 3, 1, 2), 0.625)])
@pytest.mark.slow
def test_poses_of_a_pair_are_those_at_the_middle_of_its_data(order: tuple[int, ...], centroid: float) -> None:
    """Level-dependent light falls into the second and third slot; poses refer to these slots."""

    def even(t: Floats) -> Floats:
        return np.stack([40.3 + 200 * t, 48.8 - 200 * t], -1)

    changes = "receive.receiver=soft", "signal.data_pairs=24", f"signal.slot_order={list(order)}"
    settings, recorder = link(*changes), Recorder()
    frames = drawn_film(settings, 57, even, distance_m=60.0)
    packets = list(receive_frames(frames, settings.signal, settings.receive, recorder))
    assert [packet.status for packet in packets] == ["ok"]
    # skip the velocity transient
    events = recorder.of(ExtractEvent)[8:]
    times = np.array([frame.time_s + centroid * 1e-3 for event in events for frame in event.frames])
    places = np.array([(pose.x, pose.y) for event in events for pose in event.poses])
    off = places - even(times)
    # 0.025 px: motion during an eighth of a pattern
    assert np.abs(off.mean(0)).max() < 0.0125
    assert len(recorder.of(DecodeEvent)[0].cutouts) == 24


@pytest.mark.slow
def test_poses_of_a_combined_pair_are_those_at_the_middle_of_its_data() -> None:
    """Two frames show the pattern and two the inverse.

    A level k lights the first k slots: slot r is lit at k if slot 3 - r is dark at 4 - k. Random data use both levels
    equally often, so both halves of a pattern follow the data alike, and data light is centred.
    """

    def even(t: Floats) -> Floats:
        return np.stack([40.3 + 200 * t, 48.8 - 200 * t], -1)

    settings, recorder = link("receive.receiver=soft", "signal.data_pairs=24"), Recorder()
    frames = drawn_film(settings, 108, even, exposed_slots=2, distance_m=60.0)
    packets = list(receive_frames(frames, settings.signal, settings.receive, recorder))
    assert [packet.status for packet in packets] == ["ok"]
    off = []
    for number, cutout in enumerate(recorder.of(DecodeEvent)[0].cutouts):
        assert cutout is not None
        assert cutout.combination is not None
        assert len(cutout.combination.frames) == 4
        # the packet starts at 0 with two header pairs
        middles = 1e-3 * (2 * (2 + number) + np.array([0.5, 1.5]))
        off.append([(pose.x, pose.y) for pose in cutout.poses] - even(middles))
    assert len(off) == 24
    # skip the velocity transient; 0.025 px is the motion during an eighth of a pattern
    assert np.abs(np.mean(off[8:], 0)).max() < 0.0125


@pytest.mark.slow
def test_leds_taken_for_dead_by_mistake_cost_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def mistaken(
        self: LedGains, cutout: Cutout, header: Floats, gain: float, visible: Floats
    ) -> tuple[LedGains, float, bool]:
        sight = np.where(np.arange(SIDE)[:, None] < 4, 0.0, np.ones((SIDE, SIDE)))
        return LedGains(sight, np.ones((SIDE, SIDE))), gain, False

    monkeypatch.setattr(LedGains, "learn_header", mistaken)
    settings = link("receive.receiver=soft", distance_m=80.0)
    packets = list(receive_frames(film(settings, 101), settings.signal, settings.receive))
    assert [word.status for by in packets[0].layers.values() for word in by] == ["ok"] * 4


@pytest.mark.parametrize(("px_a_frame", "learnt"), [(0.1, True), (0.5, False)])
@pytest.mark.slow
def test_leds_are_not_learnt_where_light_smears(
    px_a_frame: float, learnt: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For a fast lateral pass, smeared LEDs seemed dim, which biased poses and made more LEDs seem dim."""

    def passing(t: Floats) -> Floats:
        return np.stack([40.3 + 1e3 * px_a_frame * t, np.full_like(t, 48.8)], -1)

    calls, headers, data = list[str](), LedGains.learn_header, LedGains.learn_data

    def by_header(self: LedGains, *args: Any) -> tuple[LedGains, float, bool]:
        calls.append("header")
        return headers(self, *args)

    def by_data(self: LedGains, pairs: Sequence[DecodedPair], gain: float, noise: float) -> LedGains:
        calls.extend(["data"] * len(pairs))
        return data(self, pairs, gain, noise)

    monkeypatch.setattr(LedGains, "learn_header", by_header)
    monkeypatch.setattr(LedGains, "learn_data", by_data)
    settings = link("receive.receiver=soft", "signal.data_pairs=24")
    frames = drawn_film(settings, 108, passing, distance_m=40.0)
    packets = list(receive_frames(frames, settings.signal, settings.receive))
    assert [packet.status for packet in packets] == ["ok", "ok"]
    assert set(calls) == ({"header", "data"} if learnt else set())


@pytest.mark.parametrize("mistaken", [False, True])
def test_what_headers_have_shown_stays_unless_other_leds_are_in_sight(mistaken: bool) -> None:
    sound, values = np.ones((SIDE, SIDE)), np.random.default_rng(0).uniform(0.5, 1.5, (SIDE, SIDE))
    shown = PairStatistics(np.eye(SIDE**2, dtype=np.float32), np.zeros(SIDE**2), np.zeros(SIDE**2), 0.0, 0.0)
    before = LedGains(sound - mistaken * np.eye(SIDE), sound, shown)
    reader = HeaderReader(3, SignalSettings(), is_plain=False)
    reader.led_gains = before
    reader.next(LedGains(sound, values))
    after = reader.led_gains
    assert np.array_equal(after.values, values)
    if mistaken:
        assert after.headers is None
    else:
        # the next packet gives this packet's headers less weight
        assert after.headers is not None
        faded = before.faded().headers
        assert faded is not None
        assert np.array_equal(after.headers.gram, faded.gram)
