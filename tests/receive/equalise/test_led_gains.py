"""LED gains estimated from headers, and brightness estimated from decoded data."""

import numpy as np
import pytest
from drawn_packets import GAIN, LED_GAINS, NOISE, UNEQUAL, drawn_packet, drawn_pair
from known_packets import FORM
from scenes import ALL_ON, SIDE, Floats, film, link, pitch_at

from heliograph.base.threads import one_thread
from heliograph.receive import Pose, receive_frames
from heliograph.receive.equalise import led_gains
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.equalise.pose_refinement import ObservedPacket
from heliograph.receive.observe.cutout import take_cutout
from heliograph.signal.header import header_levels

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
    """Header statistics add up; each packet halves the weight of earlier headers."""
    first, single = learnt()[0], learnt(seed=5)[0]
    both = learnt(before=first, seed=5)[0]
    assert matched(both) == pytest.approx(matched(first) + matched(single))
    assert np.array_equal(both.faded().values, both.values)
    assert matched(both.faded()) == pytest.approx(0.5 * matched(both))
    assert LedGains.sound(SIDE).faded().headers is None


def test_a_change_forgets_earlier_headers() -> None:
    """The pose came from an incorrect image, so the pair is evaluated again."""
    # three faded packets let a new header override the history at once
    led_gains, _, changed = learnt(True, before=learnt()[0].faded().faded().faded())
    assert changed
    assert led_gains.headers is None
    again, _, changed = learnt(True, before=led_gains, seed=6)
    assert not changed
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
    """Return the brightness information, summed over LEDs."""
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
    """With gains from headers only, the low layer fails in all packets."""
    settings = link("receive.receiver=soft", distance_m=95.0, arrays=[{"x_m": 0.0, "y_m": 0.0, "spread": 0.2}])
    packets = list(receive_frames(film(settings, 301, roi_margin_px=24), settings.signal, settings.receive))
    assert [packet.status for packet in packets] == ["ok"] * 3
