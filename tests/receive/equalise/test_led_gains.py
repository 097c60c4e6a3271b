"""LED gains estimated from headers."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import SIDE, draw, frame_of, pitch_at

from heliograph.base.frames import Frame
from heliograph.receive import Pose
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.observe.cutout import take_cutout
from heliograph.receive.sync.pairing import FramePair
from heliograph.signal.header import header_levels

Floats = NDArray[np.float64]

POSE = Pose(30.2, 29.7, pitch_at(60.0), 0.01, 0.55)
HEADER = header_levels(5, SIDE) / 2.0 - 1.0
SOUND = np.ones((SIDE, SIDE))


def shot(light: Floats, index: int, rng: np.random.Generator) -> Frame:
    noisy = np.clip(np.round(light + rng.normal(0, 1.5, light.shape)), 0, 255)
    return Frame(index, index * 1e-3, noisy.astype(np.uint8), 8)


def learnt(
    gains: Floats,
    stuck: Floats,
    expected: float,
    before: LedGains | None = None,
    seed: int = 4,
    in_sight: Floats = SOUND,
) -> tuple[LedGains, float, bool]:
    """Learn gains from a header of gain 200; stuck LEDs are lit in both frames."""
    rng = np.random.default_rng(seed)
    frames = [
        shot(200 * draw(POSE, gains * (1 + sign * HEADER) / 2 + stuck, (0, 0), (60, 60)) + 20, k, rng)
        for k, sign in enumerate((1, -1))
    ]
    cutout = take_cutout(FramePair(frames[0], frames[1]), (POSE, POSE), SIDE)
    return (before or LedGains.sound(SIDE)).learn_header(cutout, HEADER, expected, in_sight)


def failed() -> tuple[Floats, Floats]:
    """Return gains with a dead LED, a stuck LED and a hidden corner, and the stuck LED's light."""
    gains, stuck = SOUND.copy(), np.zeros((SIDE, SIDE))
    gains[2, 3] = gains[10, 12] = 0.0
    gains[12:, :4] = 0.0
    stuck[10, 12] = 1.0
    return gains, stuck


def test_failed_leds_are_found() -> None:
    gains, stuck = failed()
    led_gains, gain, changed = learnt(gains, stuck, 190.0)
    assert changed
    assert gain == pytest.approx(200, rel=0.02)
    values = led_gains.values
    assert values[gains == 0] == pytest.approx(0, abs=0.3)
    assert values[gains == 1].mean() > 0.99


def test_hidden_array_leaves_the_gains() -> None:
    before = learnt(SOUND, np.zeros((SIDE, SIDE)), 190.0)[0]
    result = learnt(SOUND, np.zeros((SIDE, SIDE)), 190.0, before, in_sight=np.zeros((SIDE, SIDE)))
    assert result == (before, 190.0, False)


def test_sound_leds_are_sound() -> None:
    led_gains, _, changed = learnt(SOUND, np.zeros((SIDE, SIDE)), 190.0)
    assert not changed
    assert (led_gains.values == 1).all()


@pytest.mark.parametrize("factor", [0.3, 0.6, 1.6, 3.5])
def test_gains_are_relative_to_the_median_led(factor: float) -> None:
    """For any expected gain, intact LEDs have gain 1 and define the array gain."""
    gains, stuck = failed()
    led_gains, gain, _ = learnt(gains, stuck, factor * 200)
    assert gain == pytest.approx(200, rel=0.06)
    assert led_gains.values[gains == 1].min() > 0.9
    assert led_gains.values[gains == 0].max() < 0.4


def test_headers_add_up_and_fade() -> None:
    """Header statistics add up; each packet halves the weight of earlier headers."""
    first = learnt(SOUND, np.zeros((SIDE, SIDE)), 200.0)[0]
    both = learnt(SOUND, np.zeros((SIDE, SIDE)), 200.0, first, seed=5)[0]
    assert first.headers is not None
    assert both.headers is not None
    single = learnt(SOUND, np.zeros((SIDE, SIDE)), 200.0, seed=5)[0].headers
    assert single is not None
    assert both.headers.matched == pytest.approx(first.headers.matched + single.matched)
    faded = both.faded()
    assert faded.headers is not None
    assert np.array_equal(faded.values, both.values)
    assert faded.headers.matched == pytest.approx(0.5 * both.headers.matched)
    assert LedGains.sound(SIDE).faded().headers is None


def test_a_change_forgets_earlier_headers() -> None:
    """The pose came from an incorrect image, so the pair is evaluated again."""
    gains, stuck = failed()
    first = learnt(SOUND, np.zeros((SIDE, SIDE)), 200.0)[0]
    # three faded packets let a new header override the history at once
    led_gains, _, changed = learnt(gains, stuck, 200.0, first.faded().faded().faded())
    assert changed
    assert led_gains.headers is None
    again, _, changed = learnt(gains, stuck, 200.0, led_gains, seed=6)
    assert not changed
    assert again.headers is not None


@pytest.mark.parametrize("motion", [0.0, 0.3])
@pytest.mark.parametrize("pulled", [(0.3, 0.0), (-0.2, 0.25)])
def test_a_pose_pulled_away_makes_no_led_dead(pulled: tuple[float, float], motion: float) -> None:
    rng, header = np.random.default_rng(3), header_levels(7) / 2.0 - 1.0
    pose = Pose(30.3, 29.8, pitch_at(95), 0.0, 0.51)
    poses = pose, pose.moved(motion, -motion)
    up, down = (
        frame_of(0.1 + 0.7 * draw(p, 0.5 * (1 + sign * header), (0, 0), (60, 60)), k, rng)
        for k, (p, sign) in enumerate(zip(poses, (1, -1), strict=True))
    )
    wrong = poses[0].moved(*pulled), poses[1].moved(*pulled)
    led_gains, _, changed = LedGains.sound(SIDE).learn_header(
        take_cutout(FramePair(up, down), wrong, SIDE), header, 0.7 * 255, np.ones((SIDE, SIDE))
    )
    assert not changed
    assert led_gains.values.mean() > 0.99
    assert led_gains.values.min() > (0.5 if motion else 0.99)
