"""Decoding of samples at LEDs and 2 x 2 squares, and the channel inverse against the explicit matrix."""

import itertools
from dataclasses import replace
from itertools import islice
from typing import get_args

import numpy as np
import per_led_oracle as reference
import pytest
from recorder import Recorder
from render_oracle import blur_matrix
from scenes import SIDE, draw, drawn_film, film, levels, link, pitch_at, received, statuses

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.per_led import at_leds, decode_per_led, pair_luminances, unblurred
from heliograph.receive.decode.per_quad import decode_per_quad
from heliograph.receive.events import DecodeEvent, EqualiseEvent, ExtractEvent
from heliograph.receive.geometry.kernels import cubic_at_leds, sample_cubic
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import CombinedFrame, window_around
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.packet import Words
from heliograph.receive.settings import Equaliser, PlainSettings, ReceiveSettings
from heliograph.signal.formats import Format
from heliograph.signal.packet import PacketFormat

Patch = pytest.MonkeyPatch

GAIN, SIZE = 200.0, 44
POSE = Pose(21.2, 20.7, pitch_at(50), 0.0, 0.52)


def shown(pose: Pose, x: Floats, index: int = 0) -> CombinedFrame:
    light = 30.0 + GAIN * draw(pose, x, (0, 0), (SIZE, SIZE))
    return CombinedFrame(index, index * 1e-3, light.astype(np.float32), (0, 0), 255)


def pair(poses: tuple[Pose, Pose], x: Floats) -> tuple[CombinedFrame, CombinedFrame]:
    return shown(poses[0], x), shown(poses[1], 1 - x, 1)


@pytest.mark.parametrize(("distance_m", "roll", "motion", "loading", "accuracy"), [
    (60.0, 0.0, (0.0, 0.0), 1e-10, 1e-4), (60.0, 0.05, (0.0, 0.0), 1e-10, 1e-4), (50.0, 0.0, (0.05, 0.3), 1e-8, 0.05),
])  # fmt: skip
def test_inverse_restores_luminances_without_noise(
    distance_m: float, roll: float, motion: tuple[float, float], loading: float, accuracy: float
) -> None:
    pose = replace(POSE, pitch=pitch_at(distance_m), roll=roll)
    poses, x = (pose, pose.moved(*motion)), np.random.default_rng(3).integers(0, 5, (SIDE, SIDE)) / 4
    assert np.allclose(unblurred(pair(poses, x), poses, GAIN, SIDE, loading), 4 * x - 2, atol=accuracy)


def test_inverse_solves_the_normal_equations() -> None:
    pose, rng = Pose(21.2, 20.7, pitch_at(70), 0.02, 0.52), np.random.default_rng(2)
    first, second = (Frame(k, 0.0, rng.integers(0, 255, (SIZE, SIZE)).astype(np.uint8)) for k in range(2))
    # receiver window: 2.5 px beyond the array
    x0, y0, w, h = window_around(pose, SIDE, 2.5)
    a = blur_matrix(pose, SIDE, (x0, y0), (h, w))
    change = (first.pixels.astype(float) - second.pixels)[y0 : y0 + h, x0 : x0 + w].ravel() / GAIN
    expected = 2 * np.linalg.solve(a.T @ a + 1e-3 * np.eye(SIDE * SIDE), a.T @ change)
    assert np.allclose(unblurred((first, second), (pose, pose), GAIN, SIDE, 1e-3).ravel(), expected, atol=1e-5)


def test_inverse_of_dark_frames_is_zero() -> None:
    dark = Frame(0, 0.0, np.zeros((SIZE, SIZE), np.uint8))
    assert not unblurred((dark, dark), (POSE, POSE), 0.0, SIDE).any()


def test_leds_are_sampled_at_their_positions_by_default() -> None:
    assert ReceiveSettings().plain.equaliser == "none"
    frames = pair((POSE, POSE), np.random.default_rng(4).integers(0, 5, (SIDE, SIDE)) / 4)
    up, down = (at_leds(frame.pixels, frame.origin, POSE, SIDE) for frame in frames)
    expected = {"none": 2 * (up - down) / GAIN, "inverse": unblurred(frames, (POSE, POSE), GAIN, SIDE)}
    for equaliser in get_args(Equaliser):
        found = pair_luminances(frames, (POSE, POSE), GAIN, SIDE, equaliser)
        assert np.array_equal(found, expected[equaliser]), equaliser


@pytest.mark.slow
def test_inverse_has_fewer_led_errors_than_sampling() -> None:
    settings, wrong = link("signal.modulation=ook", distance_m=57.0), dict[str, float]()
    sent = [pattern > 2 for pattern in islice(levels(settings), 60)]
    frames = film(settings, len(sent), roi_margin_px=20)
    for equaliser in get_args(Equaliser):
        recorder, plain = Recorder(), PlainSettings(equaliser=equaliser)
        received(frames, replace(settings, receive=replace(settings.receive, plain=plain)), recorder)
        events = recorder.of(ExtractEvent)
        assert len(events) > 20
        read = [event.luminances > 0 for event in events if event.luminances is not None]
        wrong[equaliser] = float(np.mean(np.array(read) != [sent[event.frames[0].index] for event in events]))
    assert wrong["none"] > max(5e-3, 20 * wrong["inverse"])


def test_plain_receiver_samples_leds_at_the_pose_of_each_frame() -> None:
    def even(t: Floats) -> Floats:
        return np.stack([40.3 + 300 * t, 48.8 - 200 * t], -1)

    settings, recorder = link("signal.data_pairs=24"), Recorder()
    packets = received(drawn_film(settings, 53, even, distance_m=40.0), settings, recorder)
    assert statuses(packets) == ["ok"]
    # skip the velocity transient
    events = recorder.of(ExtractEvent)[8:]
    times = np.array([frame.time_s + 0.5e-3 for event in events for frame in event.frames])
    places = np.array([(pose.x, pose.y) for event in events for pose in event.poses])
    assert np.abs((places - even(times)).reshape(-1, 2, 2).mean(0)).max() < 0.03
    (decode,) = recorder.of(DecodeEvent)
    assert decode.luminances is not None
    assert np.array_equal(decode.luminances[8:], np.array([event.luminances for event in events]))


CUTOUT = Cutout(np.zeros((9, 9)), np.zeros((9, 9)), (0, 0), (Pose(4.0, 4.0, 1.0, 0.0, 0.5),))


def statuses_of(words: Words | None) -> list[str]:
    return [word.status for by in (words or {}).values() for word in by]


def misplaced(event: DecodeEvent, by_px: float) -> list[Cutout | None]:
    return [cutout and cutout.moved(np.array([by_px, 0.0, 0.0, 0.0])) for cutout in event.cutouts]


def test_sampling_decodes_only_synchronous_pairs() -> None:
    form, pairs = PacketFormat(link().signal), link().signal.data_pairs
    single = PacketFormat(form.settings, Format(mode="single"))
    assert decode_per_led([None] * pairs, form, 0, Decoding()) is None
    assert decode_per_led([CUTOUT] * pairs, single, 0, Decoding()) is None
    assert statuses_of(decode_per_led([CUTOUT] * pairs, form, 0, Decoding())) == ["crc_fail"] * 4


def test_sampling_decodes_only_at_the_right_pose() -> None:
    settings, recorder = link("signal.data_pairs=24", "receive.receiver=soft", distance_m=40.0), Recorder()
    received(film(settings, 53, roi_margin_px=20), settings, recorder)
    (event,) = recorder.of(DecodeEvent)
    for off_px, status in ((0.0, "ok"), (3.0, "crc_fail")):
        words = decode_per_led(misplaced(event, off_px), PacketFormat(settings.signal), event.identity, Decoding())
        assert set(statuses_of(words)) == {status}


def cubic(image: Floats, points: Floats) -> Floats:
    sample_cubic(image, points, got := np.empty(len(points)))
    return got


def test_cubic_samples() -> None:
    rng = np.random.default_rng(0)
    image, points = rng.normal(size=(9, 12)), rng.uniform(-2.5, 13, (200, 2))
    assert cubic(image, points) == pytest.approx(reference.sample_cubic(image, points), abs=1e-12)


def test_cubic_samples_of_a_parabola_are_exact() -> None:
    def parabola(x: Floats, y: Floats) -> Floats:
        return 2 + x - 0.3 * y + 0.2 * x * y + 0.1 * x * x - 0.05 * y * y

    y, x = np.mgrid[:12, :14].astype(float)
    points = np.random.default_rng(0).uniform(2, 9, (50, 2))
    assert cubic(parabola(x, y), points) == pytest.approx(parabola(*points.T))


def test_cubic_samples_at_leds() -> None:
    image, pose = np.random.default_rng(0).normal(size=(19, 22)), Pose(9.3, 10.8, 1.3, 0.05, 0.5, 0.02, -0.03)
    cubic_at_leds(image, pose.x, pose.y, pose.axes, got := np.empty((16, 16)))
    assert got.ravel() == pytest.approx(reference.sample_cubic(image, pose.leds(16).reshape(-1, 2)), abs=1e-12)


PACKET = 53  # frames per packet, with one for the phase


def unsynchronised(distance_m: float, phase: float) -> LinkSettings:
    start_s = f"channel.arrays.0.start_s={phase * 1e-3}"
    return link("signal.data_pairs=24", "receive.receiver=soft", start_s, distance_m=distance_m)


@pytest.mark.parametrize(("phase", "distance_m"), [(0.07, 30.0), (0.5, 45.0), (0.9, 45.0), (0.2, 65.0)])
@pytest.mark.slow
def test_unsynchronised_packets_are_decoded_without_the_equaliser(phase: float, distance_m: float) -> None:
    settings, recorder = unsynchronised(distance_m, phase), Recorder()
    packets = received(film(settings, 2 * PACKET + 3, roi_margin_px=20), settings, recorder)
    assert statuses(packets) == ["ok"] * 2
    assert recorder.of(EqualiseEvent) == []


@pytest.mark.slow
def test_decoding_depends_on_the_pose_and_hardly_on_the_gain() -> None:
    settings, recorder = unsynchronised(40.0, 0.4), Recorder()
    received(film(settings, PACKET + 5, roi_margin_px=20), settings, recorder)
    (event,) = recorder.of(DecodeEvent)
    assert any(cutout is not None and cutout.combination is not None for cutout in event.cutouts)
    place = PacketFormat(settings.signal), event.identity, Decoding()
    for off_px, gain in itertools.product((0.0, 3.0), (140.0, 280.0)):
        words = decode_per_quad(misplaced(event, off_px), gain, *place)
        assert set(statuses_of(words)) == {"crc_fail" if off_px else "ok"}


def test_far_layers_are_decoded_once_the_light_of_the_others_is_known() -> None:
    settings, recorder = link("signal.data_pairs=48", "receive.receiver=soft", distance_m=85.0), Recorder()
    received(film(settings, 105, roi_margin_px=20), settings, recorder)
    (event,) = recorder.of(DecodeEvent)
    place = PacketFormat(settings.signal), event.identity, Decoding(algorithm="max-log")
    alone = decode_per_led(event.cutouts, *place)
    assert statuses_of(alone)[:3] == ["ok", "crc_fail", "crc_fail"]
    words = decode_per_quad(event.cutouts, 190.0, *place, alone)
    assert words is not None
    assert statuses_of(words)[:3] == ["ok"] * 3
    assert [w.block for w in words["middle"]] == [w.block for w in event.packet.layers["middle"]]


def test_missing_pairs_are_erased() -> None:
    form = PacketFormat(link("signal.data_pairs=24").signal)
    words = decode_per_quad([CUTOUT, *[None] * 23], 100.0, form, 0, Decoding())
    assert set(statuses_of(words)) == {"crc_fail"}


@pytest.mark.parametrize(
    "form", [PacketFormat(link().signal, Format(mode="single")), PacketFormat(link("signal.modulation=ook").signal)]
)
def test_only_the_hierarchical_code_with_inverses_is_decoded(form: PacketFormat) -> None:
    assert decode_per_quad([CUTOUT] * form.settings.data_pairs, 100.0, form, 0, Decoding()) is None
