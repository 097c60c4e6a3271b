"""LED gains and poses refined from headers, decoded data and the power of differences."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_packets import GAIN, LED_GAINS, NOISE, UNEQUAL, drawn_packet, drawn_pair
from known_packets import FORM
from scenes import ALL_ON, SIDE, Floats, draw, film, frame_of, link, pitch_at

from heliograph.base.threads import one_thread
from heliograph.receive.api import receive_frames
from heliograph.receive.equalise import led_gains
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.equalise.pose_refinement import ObservedPacket, align_by_power, is_significant, smoothed_errors
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.observe.cutout import Cutout, take_cutout
from heliograph.receive.sync.pairing import FramePair
from heliograph.signal.formats import Format
from heliograph.signal.header import header_levels
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

POSE = Pose(30.2, 29.7, pitch_at(60.0), 0.01, 0.55)
HEADER = header_levels(5, SIDE) / 2.0 - 1.0
NO_LED = np.zeros((SIDE, SIDE))
FAILED, STUCK = ALL_ON.copy(), NO_LED.copy()
FAILED[2, 3] = FAILED[10, 12] = 0.0
FAILED[12:, :4] = 0.0
STUCK[10, 12] = 1.0
"""Gains with a dead LED, a stuck LED and a hidden corner, and the stuck LED's light."""


def learnt(
    failed: bool = False, expected: float = 190.0, before: LedGains | None = None, seed: int = 4, hidden: bool = False
) -> tuple[LedGains, float, bool]:
    """Learn gains from a header of gain 200; a stuck LED is lit in both frames."""
    gains, stuck = (FAILED, STUCK) if failed else (ALL_ON, NO_LED)
    lit = [gains * (1 + sign * HEADER) / 2 + stuck for sign in (1, -1)]
    pair = drawn_pair((POSE, POSE), (lit[0], lit[1]), np.random.default_rng(seed), 200.0)
    cutout = take_cutout(pair, (POSE, POSE), SIDE)
    return (before or LedGains.sound(SIDE)).learn_header(cutout, HEADER, expected, NO_LED if hidden else ALL_ON)


def test_a_hidden_array_keeps_the_gains() -> None:
    before, _, changed = learnt()
    assert (changed, (before.values == 1).all()) == (False, True)
    assert learnt(before=before, hidden=True) == (before, 190.0, False)


@pytest.mark.parametrize("factor", [0.3, 0.6, 0.95, 1.6, 3.5])
def test_failed_leds_are_found_and_gains_are_relative_to_the_median_led(factor: float) -> None:
    """For any expected gain, intact LEDs have gain 1 and define the array gain."""
    led_gains, gain, changed = learnt(True, factor * 200)
    assert changed
    assert gain == pytest.approx(200, rel=0.02 if factor == 0.95 else 0.06)
    assert led_gains.values[FAILED == 1].min() > 0.9
    assert led_gains.values[FAILED == 0].max() < 0.4


def matched(found: LedGains) -> Floats:
    assert found.headers is not None
    return found.headers.matched


def test_headers_add_up_and_fade() -> None:
    first, single = learnt()[0], learnt(seed=5)[0]
    both = learnt(before=first, seed=5)[0]
    assert matched(both) == pytest.approx(matched(first) + matched(single))
    assert np.array_equal(both.faded().values, both.values)
    # each packet halves the weight of earlier headers
    assert matched(both.faded()) == pytest.approx(0.5 * matched(both))
    assert LedGains.sound(SIDE).faded().headers is None


def test_a_change_forgets_earlier_headers() -> None:
    """The pose came from an incorrect image, so the pair is evaluated again."""
    # three faded packets let a new header override the history at once
    led_gains, _, changed = learnt(True, before=learnt()[0].faded().faded().faded())
    again, _, changed_again = learnt(True, before=led_gains, seed=6)
    assert (changed, changed_again, led_gains.headers) == (True, False, None)
    assert matched(again).any()


@pytest.mark.parametrize("motion", [0.0, 0.3])
@pytest.mark.parametrize("pulled", [(0.3, 0.0), (-0.2, 0.25)])
def test_a_wrong_pose_makes_no_led_dead(pulled: tuple[float, float], motion: float) -> None:
    pose, header = Pose(30.3, 29.8, pitch_at(95), 0.0, 0.51), header_levels(7) / 2.0 - 1.0
    poses = pose, pose.moved(motion, -motion)
    pair = drawn_pair(poses, (0.5 * (1 + header), 0.5 * (1 - header)), np.random.default_rng(3))
    cutout = take_cutout(pair, (poses[0].moved(*pulled), poses[1].moved(*pulled)), SIDE)
    led_gains, _, changed = LedGains.sound(SIDE).learn_header(cutout, header, GAIN, ALL_ON)
    assert not changed
    assert led_gains.values.mean() > 0.99
    assert led_gains.values.min() > (0.5 if motion else 0.99)


def learnt_from_data(
    kind: str, known: int = 256, before: LedGains | None = None, pulled: float = 0.0, seed: int = 0
) -> LedGains:
    """Estimate brightness with poses `pulled` px off and the first `known` symbols of each pair decoded."""
    cutouts, symbols = drawn_packet(kind, seed)
    moved = [cutout.moved(np.array([pulled, -pulled, 0.0, 0.0])) for cutout in cutouts]
    variance = np.broadcast_to(np.where(np.arange(symbols.shape[1]) < known, 0.0, 1.0), symbols.shape)
    with one_thread():
        observed = ObservedPacket(moved, NOISE, FORM, before or LedGains.sound(SIDE))
        return observed.learn_gains(np.where(variance == 0, symbols, 0.0), variance, GAIN, NOISE.lit)


def error(found: LedGains) -> float:
    return float(np.sqrt(np.mean((found.brightness - UNEQUAL) ** 2)))


def information_of(found: LedGains) -> float:
    assert found.data is not None
    return float(found.data[0].sum(0).trace())


def test_brightness_of_unequal_and_dead_leds_is_estimated() -> None:
    """Eight pairs reduce a spread of 0.2, with all layers known or without the low layer, and not with none."""
    assert error(learnt_from_data("unequal", 192)) < 0.16
    assert error(learnt_from_data("unequal")) < 0.08
    undecoded = learnt_from_data("unequal", 0)
    assert (undecoded.brightness == 1).all()
    assert undecoded.data is None
    found, gains = learnt_from_data("dead").brightness, LED_GAINS["dead"]
    assert 0.02 <= found.min() <= found[gains == 0].max() < 0.35
    assert found[gains == 1].min() > 0.7


@pytest.mark.parametrize(("known", "pulled"), [(64, 0.0), (256, 0.0), (64, 0.1), (256, 0.1), (256, 0.3)])
def test_equal_leds_have_equal_brightness(known: int, pulled: float) -> None:
    """Noise, and poses biased by a bright background, leave brightness at 1."""
    assert (learnt_from_data("equal", known, pulled=pulled).brightness == 1).all()


@pytest.mark.parametrize("kind", ["equal", "unequal"])
def test_only_unequal_leds_change_the_brightness_of_a_packet(kind: str) -> None:
    cutouts, symbols = drawn_packet(kind)
    with one_thread():
        observed = ObservedPacket(cutouts, NOISE, FORM, LedGains.sound(SIDE))
        assert observed.apply_brightness(symbols, np.zeros_like(symbols), GAIN, NOISE.lit) == (kind == "unequal")


def test_packets_add_up_and_fade() -> None:
    first = learnt_from_data("unequal")
    both = learnt_from_data("unequal", before=first, seed=1)
    assert error(both) < 0.85 * error(first)
    assert information_of(both) > 1.8 * information_of(first)
    assert np.array_equal(both.faded().brightness, both.brightness)
    assert information_of(both.faded()) == pytest.approx(0.9 * information_of(both))


def test_learning_restarts_without_evidence() -> None:
    complete = learnt_from_data("unequal")
    values_only = complete.without_evidence
    assert information_of(complete)
    assert (values_only.data, values_only.known, LedGains.sound(SIDE).known) == (None, False, False)
    for one in (values_only, values_only.faded()):
        assert np.array_equal(one.brightness, complete.brightness)
    again = learnt_from_data("unequal", before=values_only)
    assert np.corrcoef(again.brightness.ravel(), UNEQUAL.ravel())[0, 1] > 0.9


def test_brightness_stays_without_evidence_of_pairs(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: float) -> None:
        raise np.linalg.LinAlgError

    values_only = learnt_from_data("unequal").without_evidence
    monkeypatch.setattr(led_gains, "_without_nuisance", fail)
    after = learnt_from_data("unequal", before=values_only)
    assert np.array_equal(after.brightness, values_only.brightness)
    # the packet still counts, so that learning ends
    assert after.packets == 1


@pytest.mark.slow
def test_the_low_layer_of_unequal_leds_is_decoded() -> None:
    settings = link("receive.receiver=soft", distance_m=95.0, arrays=[{"x_m": 0.0, "y_m": 0.0, "spread": 0.2}])
    packets = list(receive_frames(film(settings, 301, roi_margin_px=24), settings.signal, settings.receive))
    assert [packet.status for packet in packets] == ["ok"] * 3


PAIRS, SHAPE = FORM.settings.data_pairs, (60, 60)


class Packet:
    """A packet at 95 m with pose errors `pulled` (pairs, 4) in x, y, ln pitch and roll, and missing pairs."""

    def __init__(self, pulled: Floats, missing: tuple[int, ...] = ()):
        cutouts, self.symbols = drawn_packet()
        self.seen = [None if k in missing else one.moved(pulled[k]) for k, one in enumerate(cutouts)]
        with one_thread():
            self.observed = ObservedPacket(self.seen, NOISE, FORM, LedGains.sound(SIDE))

    def refine(self, known: int) -> bool:
        """Refine poses from the first `known` symbols in each pair; return True if a pose moved."""
        variance = np.broadcast_to(np.where(np.arange(256) < known, 0.0, 1.0), self.symbols.shape)
        with one_thread():
            return self.observed.refine_poses(self.symbols * (variance == 0), variance, GAIN, NOISE.lit)

    @property
    def errors(self) -> Floats:
        corrections = np.zeros((PAIRS, 4))
        for k, (cutout, pair) in enumerate(zip(self.seen, self.observed.pairs, strict=True)):
            if cutout is not None and pair is not None:
                corrections[k] = (pair.cutout.middle.vector() - cutout.middle.vector())[:4]
        return corrections


def pulled_by(x: float, y: float, roll: float = 0.0) -> Floats:
    return np.tile([x, y, 0.0, roll], (PAIRS, 1))


@pytest.mark.parametrize(("known", "left"), [(64, 0.04), (192, 0.01)])
def test_a_refinement_finds_pose_errors_and_corrects_the_statistics_once(known: int, left: float) -> None:
    pulled = pulled_by(0.15, -0.1, 0.01)
    pulled[:, 0] += 0.05 * np.sin(np.arange(PAIRS) / 4)
    packet, right = Packet(pulled), Packet(np.zeros((PAIRS, 4)))

    def distance() -> float:
        """Return the mean difference from statistics at true poses."""
        pairs = zip(packet.observed.statistics, right.observed.statistics, strict=True)
        return float(np.mean([np.abs(a.gram - b.gram).mean() for a, b in pairs if a and b]))

    before, statistics = distance(), list(packet.observed.statistics)
    assert packet.refine(known)
    assert all(one is not other for one, other in zip(packet.observed.statistics, statistics, strict=True))
    # corrections are the negative pose errors
    assert np.sqrt(((packet.errors + pulled)[:, :2] ** 2).mean()) < left
    assert np.sqrt((pulled[:, :2] ** 2).mean()) > 0.12
    if known == 192:
        assert distance() < 0.2 * before
        # a second refinement includes earlier corrections and changes no pose
        first = packet.errors.copy()
        packet.refine(known)
        assert np.abs(packet.errors - first).max() < 0.02
        assert np.sqrt(((packet.errors + pulled)[:, :2] ** 2).mean()) < 0.01


@pytest.mark.parametrize(("off_px", "known"), [(0.0, 64), (0.1, 0)])
def test_right_poses_and_poses_without_decoded_symbols_stay(off_px: float, known: int) -> None:
    packet = Packet(pulled_by(off_px, off_px))
    before = list(packet.observed.statistics)
    assert not packet.refine(known)
    assert not packet.errors.any()
    assert all(one is other for one, other in zip(packet.observed.statistics, before, strict=True))


@pytest.mark.parametrize(("movement", "expected"), [
    ((0.0, 0.02, 0.0, 0.0), True), ((0.0, 0.0, 0.0, 0.01), True), ((-0.011, 0.0, 0.0, 0.0), True),
    # pitch and roll move the rim, 4 px from the centre
    ((0.009, -0.009, 0.0, 0.0), False),
    ((0.0, 0.0, 0.002, 0.002), False), ((0.0, 0.0, 0.003, 0.0), True),
])  # fmt: skip
def test_a_movement_of_a_hundredth_of_a_pixel_is_significant(movement: tuple[float, ...], expected: bool) -> None:
    assert is_significant(np.array(movement)) == expected


def test_missing_pairs_are_replaced_in_the_sample() -> None:
    """Refinement samples every third pair; if those are missing, others replace them."""
    packet = Packet(pulled_by(0.1, 0.1), missing=tuple(range(0, PAIRS, 3)))
    assert packet.refine(192)
    seen = np.arange(PAIRS) % 3 > 0
    assert np.abs(packet.errors[seen, :2] + 0.1).max() < 0.04
    assert [one is None for one in packet.observed.statistics] == (~seen).tolist()


def test_poses_of_single_mode_stay() -> None:
    """Decision-directed tracking already used the data."""
    single = PacketFormat(SignalSettings(data_pairs=24), Format(mode="single"))
    observed = ObservedPacket([None] * 48, NOISE, single, LedGains.sound(SIDE))
    assert not observed.refine_poses(np.ones((48, 256)), np.zeros((48, 256)), GAIN, NOISE.lit)


def test_sharp_evidence_is_not_smoothed_and_adds_to_earlier_corrections() -> None:
    rng, sharp, before = np.random.default_rng(2), 1e8 * np.eye(4), np.tile([0.06, 0.0, 0.0, 0.0], (12, 1))
    error = np.array([0.1, -0.05, 0.002, 0.004]) + rng.normal(0, [0.02, 0.02, 1e-4, 1e-4], (12, 4))
    evidence = {k: (sharp, sharp @ (error[k] - before[k])) for k in range(12)}
    assert smoothed_errors(evidence, before) == pytest.approx(error, abs=1e-4)
    assert smoothed_errors({}, before) is before


def test_neighbours_share_errors_and_far_pairs_do_not() -> None:
    """Errors vary within 8 pairs or stay constant; the first ten pairs have no evidence."""
    rng, quick = np.random.default_rng(3), np.zeros((80, 4))
    quick[40:44, 0] = 0.2
    evidence = {k: (1e4 * np.eye(4), 1e4 * (quick[k] + rng.normal(0, 0.01, 4))) for k in range(10, 80, 3)}
    found = smoothed_errors(evidence, np.zeros((80, 4)))
    assert found[41:43, 0] == pytest.approx([0.2, 0.2], abs=0.07)
    assert np.abs(found[:10, 0]).max() < 0.05
    constant = {k: (1e4 * np.eye(4), 1e4 * np.array([0.2, 0, 0, 0])) for k in evidence}
    assert smoothed_errors(constant, np.zeros((80, 4)))[:, 0] == pytest.approx(0.2, abs=0.05)


FAR = Pose(29.6, 30.3, pitch_at(95.0), 0.02, 0.53)


def even(true: Pose, taken: Pose, led_gains: Floats = ALL_ON) -> Cutout:
    """Return a cut-out at a possibly wrong pose; its difference shows all LEDs on."""
    dark = frame_of(np.zeros(SHAPE), 0, np.random.default_rng(0))
    cutout = take_cutout(FramePair(dark, dark), (taken, taken), SIDE)
    light = 90 * draw(true, led_gains, cutout.corner, cutout.shape)
    return Cutout(light, light, cutout.corner, cutout.poses)


def errors(cutouts: list[Cutout | None], true: Pose = FAR) -> Floats:
    return np.array([(one.middle.x - true.x, one.middle.y - true.y) for one in cutouts if one is not None])


@pytest.mark.parametrize("distance_m", [50.0, 95.0])
def test_wrong_poses_move_to_the_power_of_the_differences(distance_m: float) -> None:
    rng, pose = np.random.default_rng(6), replace(FAR, pitch=pitch_at(distance_m))
    wrong, cutouts = pose.moved(-1.3, 0.7), list[Cutout | None]()
    for _ in range(24):
        levels = rng.binomial(4, 0.5, (SIDE, SIDE)) / 4
        cutouts.append(take_cutout(drawn_pair((pose, pose), (levels, 1 - levels), rng), (wrong, wrong), SIDE))
    cutouts[5] = None
    moved, largest = align_by_power(cutouts, ALL_ON)
    assert largest == pytest.approx(np.hypot(1.3, 0.7), abs=0.4)
    assert moved[5] is None
    assert np.abs(errors(moved, pose)).max() < 0.4


@pytest.mark.parametrize("off", [(0.4, 0.0), (0.0, -0.4), (-1.4, 2.3), (3.3, -0.6), (0.0, 0.0)])
def test_errors_are_found_between_pixels(off: tuple[float, float]) -> None:
    moved, largest = align_by_power([even(FAR, FAR.moved(*off))], ALL_ON)
    assert errors(moved)[0] == pytest.approx((0, 0), abs=0.08)
    assert largest == pytest.approx(np.hypot(*off), abs=0.1)


def test_each_pair_follows_its_neighbours() -> None:
    """The smoothing window covers eight pairs on each side."""
    off = [FAR.moved(2.0, 0.0)] * 20 + [FAR.moved(-2.0, 0.0)] * 20
    moved, _ = align_by_power([even(FAR, taken) for taken in off], ALL_ON)
    found = errors(moved)[:, 0]
    # pairs with a constant error inside the window
    assert found[[*range(12), *range(28, 40)]] == pytest.approx(np.zeros(24), abs=0.08)
    # symmetric transition around the change
    assert (np.abs(found[12:28] - found[[11]]) > 1e-3).all()
    assert found[12:20] == pytest.approx(-found[20:28][::-1])


def test_hidden_leds_have_no_power() -> None:
    pose, right = replace(FAR, pitch=pitch_at(50.0)), ALL_ON.copy()
    right[:, :8] = 0
    cutout = even(pose, pose, right)
    for one, gains in ((cutout, right), (replace(cutout, in_sight=right), ALL_ON)):
        assert errors(align_by_power([one], gains)[0], pose)[0] == pytest.approx((0, 0), abs=0.08)


def test_missing_pairs_have_no_weight_and_corrections_are_limited() -> None:
    moved, largest = align_by_power([None, even(FAR, FAR.moved(0.0, 1.0)), None, None], ALL_ON)
    assert [one is None for one in moved] == [True, False, True, True]
    assert largest == pytest.approx(1.0, abs=0.08)
    assert align_by_power([None, None], ALL_ON) == ([None, None], 0.0)
    # to 4 px grid steps plus 1 px from the parabola
    assert 1.0 <= errors(align_by_power([even(FAR, FAR.moved(6.0, 0.0))], ALL_ON)[0])[0, 0] <= 2.5
