"""Packets of the soft receiver: samples at the LEDs, then the equaliser with repeated assumptions."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from known_packets import FORM
from recorder import Recorder
from scenes import SIDE, drawn_film, film, link, received, statuses, words_of

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame
from heliograph.receive.decode import soft_packet
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.header_reader import HeaderReader
from heliograph.receive.decode.soft_packet import count_open, read_packet
from heliograph.receive.decode.turbo_equaliser import TurboEqualiser, decode_iteratively
from heliograph.receive.equalise.led_gains import DecodedPair, LedGains
from heliograph.receive.equalise.pose_refinement import ObservedPacket
from heliograph.receive.events import DecodeEvent, EqualiseEvent, ExtractEvent
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.observe.cutout import Cutout, Noise
from heliograph.receive.observe.statistics import PairStatistics
from heliograph.receive.packet import Codeword, Packet, Words
from heliograph.signal.settings import SignalSettings

SETTINGS = link("receive.receiver=soft", "signal.data_pairs=24")
PACKET = 52  # frames per packet: two header pairs and 24 data pairs

SEEMS_DEAD = LedGains(np.where(np.arange(SIDE)[:, None] < 4, 0.0, np.ones((SIDE, SIDE))), np.ones((SIDE, SIDE)))
CUTOUT = Cutout(np.zeros((9, 9)), np.zeros((9, 9)), (0, 0), (Pose(4.0, 4.0, 1.0, 0.0, 0.5),))


def high_words(read: str) -> Words:
    """Return high layer codewords; x marks decoded codewords."""
    bits = np.zeros(8, np.uint8)
    return {"high": tuple(Codeword("ok" if mark == "x" else "crc_fail", None, bits, bits, 1, 0.0) for mark in read)}


Attempt = tuple[Sequence[Cutout | None], LedGains, Words | None]


def read(
    results: list[str], cutout: Cutout | None, led_gains: LedGains = SEEMS_DEAD, known: Words | None = None
) -> tuple[TurboEqualiser, list[TurboEqualiser], list[Attempt]]:
    """Read a packet with scripted results; return the reading, the equalised packets and the assumptions tried."""
    packets, tried = list[TurboEqualiser](), list[Attempt]()

    def equalise(cutouts: Sequence[Cutout | None], led_gains: LedGains, known: Words | None) -> TurboEqualiser:
        observed = ObservedPacket([None], Noise(1.0, 1.0), FORM, led_gains)
        packets.append(TurboEqualiser(observed, 1.0, 1.0, 0, Decoding(), None))
        packets[-1].words = high_words(results[len(tried)])
        tried.append((cutouts, led_gains, known))
        return packets[-1]

    return read_packet([cutout], led_gains, FORM, known, equalise), packets, tried


@pytest.fixture
def shifted(monkeypatch: pytest.MonkeyPatch) -> None:
    def moved(cutouts: Sequence[Cutout | None], led_gains: Floats) -> tuple[list[Cutout | None], float]:
        return [cutout and cutout.moved(np.array([1.0, 0.0, 0.0, 0.0])) for cutout in cutouts], 1.0

    monkeypatch.setattr(soft_packet, "align_by_power", moved)


@pytest.mark.parametrize(("results", "open_", "best"), [
    (["xxx"], 0, 0), (["xx-", "xxx"], 0, 1),
    # no better individually, but the decoded codewords count
    (["xx-", "--x"], 0, 0),
    (["x--", "-x-", "--x"], 0, 0), (["---", "x--", "xx-"], 1, 2), (["---", "---", "---"], 3, 0),
])  # fmt: skip
@pytest.mark.usefixtures("shifted")
def test_packet_is_read_until_all_codewords_are_decoded(results: list[str], open_: int, best: int) -> None:
    reading, packets, tried = read(results, CUTOUT)
    assert (len(tried), count_open(reading.words)) == (len(results), open_)
    assert reading is packets[best]
    assert all(led_gains is SEEMS_DEAD or (led_gains.values == 1).all() for _, led_gains, _ in tried)
    # shifted poses come last
    assert [cutouts[0] is CUTOUT for cutouts, *_ in tried] == [True, True, False][: len(tried)]


def test_packet_without_dead_leds_is_read_once() -> None:
    assert len(read(["--"], None, LedGains.sound(SIDE))[2]) == 1


def test_known_codewords_are_equalised_too_until_the_brightness_is_learnt() -> None:
    known, sound = high_words("x-"), LedGains.sound(SIDE)
    for led_gains, expected in ((sound, [known, None]), (replace(sound, packets=1), [known])):
        assert [given for *_, given in read(["--"] * 2, None, led_gains, known)[2]] == expected


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
    cutouts = [cutout for cutout in recorder.of(DecodeEvent)[0].cutouts if cutout is not None]
    assert [cutout.combination and len(cutout.combination.frames) for cutout in cutouts] == [4] * 24
    places = np.array([(pose.x, pose.y) for cutout in cutouts for pose in cutout.poses])
    # the packet starts at 0 with two header pairs
    off = places - diagonal(1e-3 * (np.arange(4.0, 52.0) + 0.5))
    # skip the velocity transient; 0.025 px is the motion during an eighth of a pattern
    assert np.abs(off[16:].reshape(-1, 2, 2).mean(0)).max() < 0.0125


@pytest.mark.slow
def test_leds_mistaken_for_dead_cost_no_codeword(monkeypatch: pytest.MonkeyPatch) -> None:
    def mistaken(_self: LedGains, _cutout: Cutout, _header: Floats, gain: float, _visible: Floats) -> Any:
        return SEEMS_DEAD, gain, False

    monkeypatch.setattr(LedGains, "learn_header", mistaken)
    settings = link("receive.receiver=soft", "signal.data_pairs=24", distance_m=80.0)
    packets = received(film(settings, PACKET + 1, roi_margin_px=20), settings)
    assert [word.status for word in words_of(packets[0])] == ["ok"] * 4


@pytest.fixture
def learnt(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Record each time LED gains are learnt: 0 for a header, else the number of data pairs."""
    calls, learn_header, learn_data = list[int](), LedGains.learn_header, LedGains.learn_data

    def by_header(self: LedGains, *args: Any) -> Any:
        calls.append(0)
        return learn_header(self, *args)

    def by_data(self: LedGains, pairs: Sequence[DecodedPair], gain: float, noise: float) -> LedGains:
        calls.append(len(pairs))
        return learn_data(self, pairs, gain, noise)

    monkeypatch.setattr(LedGains, "learn_header", by_header)
    monkeypatch.setattr(LedGains, "learn_data", by_data)
    return calls


@pytest.mark.parametrize(("px_a_frame", "is_learnt"), [(0.1, True), (0.5, False)])
@pytest.mark.slow
def test_smeared_leds_are_not_learnt(px_a_frame: float, is_learnt: bool, learnt: list[int]) -> None:
    """For a fast lateral pass, smeared LEDs seemed dim, which biased poses and made more LEDs seem dim."""

    def passing(t: Floats) -> Floats:
        return np.stack([40.3 + 1e3 * px_a_frame * t, np.full_like(t, 48.8)], -1)

    packets = received(drawn_film(SETTINGS, PACKET + 5, passing, distance_m=40.0), SETTINGS)
    assert statuses(packets) == ["ok"]
    # from headers and from data
    assert (0 in learnt, any(learnt)) == (is_learnt, is_learnt)


@pytest.mark.parametrize("mistaken", [False, True])
def test_header_evidence_fades_and_ends_when_other_leds_are_visible(mistaken: bool) -> None:
    sound, values = np.ones((SIDE, SIDE)), np.random.default_rng(0).uniform(0.5, 1.5, (SIDE, SIDE))
    shown = PairStatistics(np.eye(SIDE**2, dtype=np.float32), np.zeros(SIDE**2), np.zeros(SIDE**2), 0.0, 0.0)
    before = LedGains(sound - mistaken * np.eye(SIDE), sound, shown)
    reader = HeaderReader(3, SignalSettings(), is_plain=False)
    reader.led_gains = before
    reader.next(LedGains(sound, values))
    after, faded = reader.led_gains, before.faded().headers
    assert np.array_equal(after.values, values)
    assert faded is not None
    # the next packet gives this packet's headers less weight
    kept = None if after.headers is None else after.headers.gram.tolist()
    assert kept == (None if mistaken else faded.gram.tolist())


@cache
def film_at_rest(distance_m: float) -> list[Frame]:
    return film(link("signal.data_pairs=24", distance_m=distance_m), 3 * PACKET + 3, roi_margin_px=20)


def read_at_rest(distance_m: float, **soft: Any) -> tuple[list[Packet], Recorder]:
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
def test_leds_are_learnt_from_packets_that_are_not_equalised(learnt: list[int]) -> None:
    packets, recorder = read_at_rest(25.0)
    assert statuses(packets) == ["ok"] * 3
    assert recorder.of(EqualiseEvent) == []
    # a single packet is insufficient at this distance
    assert [count for count in learnt if count][:3] == [8] * 3
