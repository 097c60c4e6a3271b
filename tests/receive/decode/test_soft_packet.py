"""Packets of the soft receiver: samples at the LEDs, then the equaliser with repeated assumptions."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from known_packets import FORM
from numpy.typing import NDArray
from recorder import Recorder
from scenes import SIDE, drawn_film, film, link, received, statuses, words_of

from heliograph.base.frames import Frame
from heliograph.receive import Codeword, Packet, Pose
from heliograph.receive.decode import soft_packet
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.header_reader import HeaderReader
from heliograph.receive.decode.soft_packet import count_open, read_packet
from heliograph.receive.decode.turbo_equaliser import TurboEqualiser, decode_iteratively
from heliograph.receive.equalise.led_gains import DecodedPair, LedGains
from heliograph.receive.equalise.pose_refinement import ObservedPacket
from heliograph.receive.events import DecodeEvent, EqualiseEvent, ExtractEvent
from heliograph.receive.observe.cutout import Cutout, Noise
from heliograph.receive.observe.statistics import PairStatistics
from heliograph.receive.packet import Words
from heliograph.signal.settings import SignalSettings

Floats = NDArray[np.float64]

SETTINGS = link("receive.receiver=soft", "signal.data_pairs=24")
PACKET = 52
"""Frames per packet: two header pairs and 24 data pairs."""

SEEMS_DEAD = LedGains(np.where(np.arange(SIDE)[:, None] < 4, 0.0, np.ones((SIDE, SIDE))), np.ones((SIDE, SIDE)))
CUTOUT = Cutout(np.zeros((9, 9)), np.zeros((9, 9)), (0, 0), (Pose(4.0, 4.0, 1.0, 0.0, 0.5),))


def high_words(read: str) -> Words:
    """Return high layer codewords; x marks decoded codewords."""
    bits = np.zeros(8, np.uint8)
    return {"high": tuple(Codeword("ok" if mark == "x" else "crc_fail", None, bits, bits, 1, 0.0) for mark in read)}


def equalised(read: str, led_gains: LedGains = SEEMS_DEAD) -> TurboEqualiser:
    """Return an equalised packet with some decoded codewords."""
    observed = ObservedPacket([None], Noise(1.0, 1.0), FORM, led_gains)
    packet = TurboEqualiser(observed, 1.0, 1.0, 0, Decoding(), None)
    packet.words = high_words(read)
    return packet


def moved(cutouts: Sequence[Cutout | None], led_gains: Floats) -> tuple[list[Cutout | None], float]:
    """Return cut-outs with shifted poses."""
    return [cutout and cutout.moved(np.array([1.0, 0.0, 0.0, 0.0])) for cutout in cutouts], 1.0


@pytest.mark.parametrize(("results", "open_", "best"), [
    (["xxx"], 0, 0), (["xx-", "xxx"], 0, 1),
    # no better individually, but the decoded codewords count
    (["xx-", "--x"], 0, 0),
    (["x--", "-x-", "--x"], 0, 0), (["---", "x--", "xx-"], 1, 2), (["---", "---", "---"], 3, 0),
])  # fmt: skip
def test_packet_is_read_until_all_codewords_are_decoded(
    results: list[str], open_: int, best: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(soft_packet, "align_by_power", moved)
    packets, tried = [equalised(result) for result in results], list[tuple[Sequence[Cutout | None], LedGains]]()

    def equalise(cutouts: Sequence[Cutout | None], led_gains: LedGains, known: Words | None) -> TurboEqualiser:
        assert known is None
        tried.append((cutouts, led_gains))
        return packets[len(tried) - 1]

    reading = read_packet([CUTOUT], SEEMS_DEAD, FORM, None, equalise)
    assert len(tried) == len(results)
    assert count_open(reading.words) == open_
    assert reading is packets[best]
    assert all(led_gains is SEEMS_DEAD or (led_gains.values == 1).all() for _, led_gains in tried)
    # shifted poses come last
    assert [cutouts[0] is CUTOUT for cutouts, _ in tried] == [True, True, False][: len(tried)]


def attempts(led_gains: LedGains, known: Words | None) -> list[tuple[LedGains, Words | None]]:
    """Record the assumptions tried for a packet that never decodes."""
    tried = list[tuple[LedGains, Words | None]]()

    def equalise(_cutouts: Sequence[Cutout | None], led_gains: LedGains, known: Words | None) -> TurboEqualiser:
        tried.append((led_gains, known))
        return equalised("--", led_gains)

    read_packet([None], led_gains, FORM, known, equalise)
    return tried


def test_packet_without_dead_leds_is_read_once() -> None:
    assert len(attempts(LedGains.sound(SIDE), None)) == 1


def test_known_codewords_are_equalised_too_until_the_brightness_is_learnt() -> None:
    known, sound = high_words("x-"), LedGains.sound(SIDE)
    assert [given for _, given in attempts(sound, known)] == [known, None]
    assert [given for _, given in attempts(replace(sound, packets=1), known)] == [known]


def diagonal(t: Floats) -> Floats:
    """Return the path of an array that moves by 0.28 px a frame."""
    return np.stack([40.3 + 200 * t, 48.8 - 200 * t], -1)


@pytest.mark.parametrize(("order", "centroid"), [((2, 0, 1, 3), 0.375), ((0, 3, 1, 2), 0.625)])
@pytest.mark.slow
def test_poses_of_a_pair_are_at_the_centroid_of_the_data_light(order: tuple[int, ...], centroid: float) -> None:
    """Level-dependent light falls into the second and third slot; poses refer to these slots."""
    settings = link("receive.receiver=soft", "signal.data_pairs=24", f"signal.slot_order={list(order)}")
    recorder = Recorder()
    packets = received(drawn_film(settings, PACKET + 5, diagonal, distance_m=60.0), settings, recorder)
    assert statuses(packets) == ["ok"]
    # skip the velocity transient
    events = recorder.of(ExtractEvent)[8:]
    times = np.array([frame.time_s + centroid * 1e-3 for event in events for frame in event.frames])
    places = np.array([(pose.x, pose.y) for event in events for pose in event.poses])
    # 0.025 px: motion during an eighth of a pattern
    assert np.abs((places - diagonal(times)).mean(0)).max() < 0.0125
    assert len(recorder.of(DecodeEvent)[0].cutouts) == 24


@pytest.mark.slow
def test_poses_of_a_combined_pair_are_at_the_centroid_of_the_data_light() -> None:
    """Two frames show the pattern and two the inverse.

    A level k lights the first k slots: slot r is lit at k if slot 3 - r is dark at 4 - k. Random data use both levels
    equally often, so both halves of a pattern follow the data alike, and data light is centred.
    """
    recorder = Recorder()
    frames = drawn_film(SETTINGS, 2 * PACKET + 4, diagonal, exposed_slots=2, distance_m=60.0)
    assert statuses(received(frames, SETTINGS, recorder)) == ["ok"]
    off = []
    for number, cutout in enumerate(recorder.of(DecodeEvent)[0].cutouts):
        assert cutout is not None
        assert cutout.combination is not None
        assert len(cutout.combination.frames) == 4
        # the packet starts at 0 with two header pairs
        middles = 1e-3 * (2 * (2 + number) + np.array([0.5, 1.5]))
        off.append([(pose.x, pose.y) for pose in cutout.poses] - diagonal(middles))
    assert len(off) == 24
    # skip the velocity transient; 0.025 px is the motion during an eighth of a pattern
    assert np.abs(np.mean(off[8:], 0)).max() < 0.0125


@pytest.mark.slow
def test_leds_mistaken_for_dead_cost_no_codeword(monkeypatch: pytest.MonkeyPatch) -> None:
    def mistaken(
        self: LedGains, cutout: Cutout, header: Floats, gain: float, visible: Floats
    ) -> tuple[LedGains, float, bool]:
        return SEEMS_DEAD, gain, False

    monkeypatch.setattr(LedGains, "learn_header", mistaken)
    settings = link("receive.receiver=soft", "signal.data_pairs=24", distance_m=80.0)
    packets = received(film(settings, PACKET + 1, roi_margin_px=20), settings)
    assert [word.status for word in words_of(packets[0])] == ["ok"] * 4


@pytest.mark.parametrize(("px_a_frame", "learnt"), [(0.1, True), (0.5, False)])
@pytest.mark.slow
def test_smeared_leds_are_not_learnt(px_a_frame: float, learnt: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """For a fast lateral pass, smeared LEDs seemed dim, which biased poses and made more LEDs seem dim."""

    def passing(t: Floats) -> Floats:
        return np.stack([40.3 + 1e3 * px_a_frame * t, np.full_like(t, 48.8)], -1)

    calls, learn_header, learn_data = list[str](), LedGains.learn_header, LedGains.learn_data

    def by_header(self: LedGains, *args: Any) -> tuple[LedGains, float, bool]:
        calls.append("header")
        return learn_header(self, *args)

    def by_data(self: LedGains, pairs: Sequence[DecodedPair], gain: float, noise: float) -> LedGains:
        calls.extend(["data"] * len(pairs))
        return learn_data(self, pairs, gain, noise)

    monkeypatch.setattr(LedGains, "learn_header", by_header)
    monkeypatch.setattr(LedGains, "learn_data", by_data)
    packets = received(drawn_film(SETTINGS, PACKET + 5, passing, distance_m=40.0), SETTINGS)
    assert statuses(packets) == ["ok"]
    assert set(calls) == ({"header", "data"} if learnt else set())


@pytest.mark.parametrize("mistaken", [False, True])
def test_header_evidence_fades_and_ends_when_other_leds_are_visible(mistaken: bool) -> None:
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


@cache
def film_at_rest(distance_m: float) -> list[Frame]:
    return film(link("signal.data_pairs=24", distance_m=distance_m), 3 * PACKET + 3, roi_margin_px=20)


def read_at_rest(distance_m: float, **soft: Any) -> tuple[list[Packet], Recorder]:
    """Return three packets of an array at rest, with the events."""
    recorder, settings = Recorder(), replace(SETTINGS.receive, soft=replace(SETTINGS.receive.soft, **soft))
    return received(film_at_rest(distance_m), replace(SETTINGS, receive=settings), recorder), recorder


@pytest.mark.slow
def test_near_packets_are_equalised_only_to_learn_the_brightness(monkeypatch: pytest.MonkeyPatch) -> None:
    known_counts = list[int]()

    def noted(*args: Any) -> Any:
        known_counts.append(sum(word.status == "ok" for words in (args[-1] or {}).values() for word in words))
        return decode_iteratively(*args)

    monkeypatch.setattr(soft_packet, "decode_iteratively", noted)
    packets, recorder = read_at_rest(40.0)
    assert statuses(packets) == ["ok"] * 3
    assert set(known_counts) == {4}
    assert recorder.of(EqualiseEvent) == []


@pytest.mark.parametrize("setting", [{"led_by_led": False}, {"feedback": "none"}], ids=str)
@pytest.mark.slow
def test_without_feedback_or_sampling_every_packet_is_equalised(setting: dict[str, Any]) -> None:
    packets, recorder = read_at_rest(40.0, **setting)
    assert len(recorder.of(EqualiseEvent)) >= len(packets)
    for sampled, equalised in zip(read_at_rest(40.0)[0], packets, strict=True):
        assert [word.block for word in words_of(sampled)] == [word.block for word in words_of(equalised)]


@pytest.mark.slow
def test_leds_are_learnt_from_packets_that_are_not_equalised(monkeypatch: pytest.MonkeyPatch) -> None:
    learnt, learn = list[int](), LedGains.learn_data

    def noted(self: LedGains, pairs: Sequence[DecodedPair], gain: float, noise: float) -> LedGains:
        learnt.append(len(pairs))
        return learn(self, pairs, gain, noise)

    monkeypatch.setattr(LedGains, "learn_data", noted)
    packets, recorder = read_at_rest(25.0)
    assert statuses(packets) == ["ok"] * 3
    assert recorder.of(EqualiseEvent) == []
    # a single packet is insufficient at this distance
    assert learnt[:3] == [8] * 3
