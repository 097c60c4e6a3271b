"""Poses sharpened by what is decoded, and LEDs told from headers, where a background has pulled the poses away."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from receive_scenes import SIDE, draw, film, frame_of, link, pitch_at
from scipy.special import erf
from soft_looks import FORM, GAIN, cells_of, looks_at, random_blocks

from heliograph.receive import Pose, ReceiveSettings, receive_frames
from heliograph.receive.soft.cancel import Light, decode_looks
from heliograph.receive.soft.glance import Glance, take_glance
from heliograph.receive.soft.look import Look, weigh
from heliograph.receive.soft.memory import Memory
from heliograph.receive.soft.noise import Noise
from heliograph.receive.soft.shares import LedShares
from heliograph.receive.soft.sharpen import Seen, pose_errors, worth_moving
from heliograph.signal import haar
from heliograph.signal.header import header_levels

Floats = NDArray[np.float64]

NOISE = Noise(4.5, 1.5)
ONES = np.ones((SIDE, SIDE))


def glances(z: float, pulled: Floats, missing: tuple[int, ...] = ()) -> tuple[list[Glance | None], Floats]:
    """Glances at a packet whose poses are off by `pulled` (pairs, 4), and its cells."""
    rng, cells = np.random.default_rng(1), cells_of(random_blocks(0))
    levels = haar.encode(FORM.join(cells.astype(np.int8))) / 4.0
    out: list[Glance | None] = []
    for k, x in enumerate(levels):
        x_px, y_px = (float(v) for v in rng.uniform(30, 31, 2))
        pose = Pose(x_px, y_px, pitch_at(z), float(rng.normal(0, 0.01)), 0.51)
        up, down = (frame_of(0.1 + 0.7 * draw(pose, y, (0, 0), (60, 60)), i, rng) for i, y in enumerate((x, 1 - x)))
        out.append(None if k in missing else take_glance(up, down, (pose, pose), SIDE).moved(pulled[k]))
    return out, cells


def errors_of(seen: list[Glance | None], cells: Floats, known: int) -> Floats:
    """Errors by a number of known cells."""
    weighted = [None if g is None else weigh(g, NOISE, SIDE) for g in seen]
    looks = [None if w is None else w.look() for w in weighted]
    variance = np.where(np.arange(cells.shape[1]) < known, 0.0, 1.0)
    what = np.where(variance == 0, cells, 0.0), np.broadcast_to(variance, cells.shape)
    light = 0.7 * 255, NOISE.lit
    return pose_errors(Seen(seen, weighted, looks, np.zeros((len(seen), 4))), light, what, FORM, ONES)


@pytest.mark.parametrize(("known", "left"), [(64, 0.04), (192, 0.01)])
def test_errors_of_poses_are_found(known: int, left: float) -> None:
    pulled = np.tile([0.15, -0.1, 0.0, 0.01], (24, 1))
    pulled[:, 0] += 0.05 * np.sin(np.arange(24) / 4)
    found = errors_of(*glances(95, pulled), known)
    # an error is what is to be added
    rest = (found + pulled)[:, :2]
    assert np.sqrt((rest**2).mean()) < left
    assert np.sqrt((pulled[:, :2] ** 2).mean()) > 0.12


def test_poses_that_are_right_stay() -> None:
    found = errors_of(*glances(95, np.zeros((24, 4))), 64)
    assert not any(worth_moving(error) for error in found)
    assert worth_moving(np.array([0.0, 0.02, 0.0, 0.0]))
    assert worth_moving(np.array([0.0, 0.0, 0.0, 0.01]))


def test_pairs_seen_are_asked_whichever_they_are() -> None:
    """Every third is asked; where those are missing, others are."""
    pulled = np.tile([0.1, 0.1, 0.0, 0.0], (24, 1))
    seen, cells = glances(95, pulled, missing=tuple(range(0, 24, 3)))
    assert np.abs(errors_of(seen, cells, 192)[:, :2] + 0.1).max() < 0.04


def test_each_decoded_layer_sharpens_the_poses() -> None:
    blocks, asked = random_blocks(0), []
    looks = looks_at(blocks, 100)

    def again(mean: Floats, variance: Floats, light: Light) -> tuple[list[Look | None], bool]:
        asked.append(int((variance[0] == 0).sum()))
        return looks, False

    settings = ReceiveSettings(receiver="soft")
    decode_looks(looks, Light(GAIN, 4.5), FORM, 5, settings, Memory(), again)
    # the high layer, then the middle one; with the low one all is known
    assert asked == [64, 192]
    asked.clear()
    still = replace(settings, soft=replace(settings.soft, sharpen=False))
    decode_looks(looks, Light(GAIN, 4.5), FORM, 5, still, Memory(), again)
    assert not asked


@pytest.mark.parametrize("motion", [0.0, 0.3])
@pytest.mark.parametrize("pulled", [(0.3, 0.0), (-0.2, 0.25)])
def test_a_pose_pulled_away_makes_no_led_dead(pulled: tuple[float, float], motion: float) -> None:
    rng, header = np.random.default_rng(3), header_levels(7) / 2.0 - 1.0
    pose = Pose(30.3, 29.8, pitch_at(95), 0.0, 0.51)
    poses = pose, pose.moved(motion, -motion)
    frames = [
        frame_of(0.1 + 0.7 * draw(p, 0.5 * (1 + sign * header), (0, 0), (60, 60)), k, rng)
        for k, (p, sign) in enumerate(zip(poses, (1, -1), strict=True))
    ]
    wrong = poses[0].moved(*pulled), poses[1].moved(*pulled)
    shares = LedShares(SIDE)
    _, changed = shares.learn(take_glance(frames[0], frames[1], wrong, SIDE), header, 0.7 * 255)
    assert not changed
    assert shares.values.mean() > 0.99
    assert shares.values.min() > (0.5 if motion else 0.99)


def test_what_moves_with_the_array_is_taken_off() -> None:
    """A bright edge behind it, a third of a pixel farther in the second frame; what is sent stays as it is."""
    rng, x = np.random.default_rng(5), haar.encode(FORM.join(cells_of(random_blocks(1))[:1].astype(np.int8)))[0] / 4.0
    pose, grid = Pose(30.3, 29.8, pitch_at(80), 0.0, 0.51), np.arange(60)
    poses = pose, pose.moved(0.3, 0.1)
    ideal, frames = [], []
    for k, (p, y) in enumerate(zip(poses, (x, 1 - x), strict=True)):
        lit = 0.6 * draw(p, y, (0, 0), (60, 60))
        edge = 0.15 * (1 + erf((grid - p.x - 7) / 0.8))[None, :] * np.ones((60, 1))
        ideal.append(255 * lit)
        frames.append(frame_of(lit + edge, k, rng))
    glance = take_glance(frames[0], frames[1], poses, SIDE)
    steady = glance.steadied(0.6 * 255, ONES)
    rows, columns = (slice(c, c + n) for c, n in zip(reversed(glance.corner), glance.change.shape, strict=True))
    sent = (ideal[0] - ideal[1])[rows, columns]
    before, after = (np.sqrt(((g.change - sent) ** 2).mean()) for g in (glance, steady))
    # the sensor's noise alone is 1.8 gray levels
    assert before > 3.5
    assert after < 2.2


def test_leds_taken_for_dead_by_mistake_cost_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def mistaken(self: LedShares, glance: Glance, header: Floats, gain: float) -> tuple[float, bool]:
        self.values = np.where(np.arange(SIDE)[:, None] < 4, 0.0, ONES)
        return gain, False

    monkeypatch.setattr(LedShares, "learn", mistaken)
    settings = link("receive.receiver=soft", distance_m=80.0)
    packets = list(receive_frames(film(settings, 101), settings.signal, settings.receive))
    assert [word.status for by in packets[0].layers.values() for word in by] == ["ok"] * 4
