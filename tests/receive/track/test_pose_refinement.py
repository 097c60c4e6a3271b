"""Pose refinement from decoded data after bias by a background."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from known_packets import FORM, random_blocks, symbols_of
from numpy.typing import NDArray
from scenes import SIDE, draw, frame_of, pitch_at

from heliograph.base.threads import one_thread
from heliograph.receive import Pose
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.equalise.pose_refinement import ObservedPacket, is_significant, smoothed_errors
from heliograph.receive.observe.cutout import Cutout, take_cutout
from heliograph.receive.observe.noise import Noise
from heliograph.receive.sync.pairing import FramePair
from heliograph.signal import haar
from heliograph.signal.formats import Format
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

Floats = NDArray[np.float64]

GAIN, NOISE = 0.7 * 255, Noise(4.5, 1.5)
PAIRS = FORM.settings.data_pairs


@dataclass(frozen=True, slots=True)
class Numbered(Cutout):
    """A cut-out recording its pose corrections in `moves`."""

    number: int = 0
    moves: dict[int, Floats] = field(default_factory=dict)

    def moved(self, error: Floats) -> Cutout:
        self.moves[self.number] = self.moves.get(self.number, np.zeros(4)) + error
        # zero-argument super() fails in classes with slots
        return Cutout.moved(self, error)


class Packet:
    """A packet at `distance_m` with pose errors `pulled` (pairs, 4) in x, y, ln pitch and roll, and missing pairs."""

    def __init__(self, distance_m: float, pulled: Floats, missing: tuple[int, ...] = ()):
        rng, self.symbols = np.random.default_rng(1), symbols_of(random_blocks(0))
        self.moves: dict[int, Floats] = {}
        cutouts: list[Cutout | None] = []
        for k, x in enumerate(haar.encode(FORM.join(self.symbols.astype(np.int8))) / 4.0):
            x_px, y_px = (float(v) for v in rng.uniform(30, 31, 2))
            pose = Pose(x_px, y_px, pitch_at(distance_m), float(rng.normal(0, 0.01)), 0.51)
            up, down = (frame_of(0.1 + 0.7 * draw(pose, y, (0, 0), (60, 60)), i, rng) for i, y in enumerate((x, 1 - x)))
            if k in missing:
                cutouts.append(None)
                continue
            one = take_cutout(FramePair(up, down), (pose, pose), SIDE).moved(pulled[k])
            cutouts.append(
                Numbered(
                    one.total, one.difference, one.corner, one.poses, covered=one.covered, number=k, moves=self.moves
                )
            )
        with one_thread():
            self.observed = ObservedPacket(cutouts, NOISE, FORM, LedGains.sound(SIDE))

    def refine(self, known: int) -> bool:
        """Refine poses from the first `known` symbols in each pair; return True if a pose moved."""
        variance = np.where(np.arange(self.symbols.shape[1]) < known, 0.0, 1.0)
        mean = np.where(variance == 0, self.symbols, 0.0)
        with one_thread():
            return self.observed.refine_poses(mean, np.broadcast_to(variance, mean.shape), GAIN, NOISE.lit)

    @property
    def errors(self) -> Floats:
        """Return accumulated corrections (pairs, 4)."""
        return np.array([self.moves.get(k, np.zeros(4)) for k in range(PAIRS)])


@pytest.mark.parametrize(("known", "left"), [(64, 0.04), (192, 0.01)])
def test_errors_of_poses_are_found(known: int, left: float) -> None:
    pulled = np.tile([0.15, -0.1, 0.0, 0.01], (PAIRS, 1))
    pulled[:, 0] += 0.05 * np.sin(np.arange(PAIRS) / 4)
    packet = Packet(95, pulled)
    before = list(packet.observed.statistics)
    assert packet.refine(known)
    # corrections are the negative pose errors
    rest = (packet.errors + pulled)[:, :2]
    assert np.sqrt((rest**2).mean()) < left
    assert np.sqrt((pulled[:, :2] ** 2).mean()) > 0.12
    assert all(one is not other for one, other in zip(packet.observed.statistics, before, strict=True))


def test_the_statistics_become_those_of_the_right_poses() -> None:
    pulled = np.tile([0.15, -0.1, 0.0, 0.01], (PAIRS, 1))
    packet, right = Packet(95, pulled), Packet(95, np.zeros((PAIRS, 4)))

    def distance() -> float:
        """Return the mean difference from statistics at true poses."""
        pairs = zip(packet.observed.statistics, right.observed.statistics, strict=True)
        return float(np.mean([np.abs(a.gram - b.gram).mean() for a, b in pairs if a and b]))

    before = distance()
    packet.refine(192)
    assert distance() < 0.2 * before


def test_poses_that_are_right_stay() -> None:
    packet = Packet(95, np.zeros((PAIRS, 4)))
    before = list(packet.observed.statistics)
    assert not packet.refine(64)
    assert not packet.moves
    assert all(one is other for one, other in zip(packet.observed.statistics, before, strict=True))


def test_what_is_found_once_is_not_found_again() -> None:
    """A second refinement includes earlier corrections and changes no pose."""
    pulled = np.tile([0.15, -0.1, 0.0, 0.0], (PAIRS, 1))
    packet = Packet(95, pulled)
    assert packet.refine(192)
    first = packet.errors.copy()
    packet.refine(192)
    assert np.abs(packet.errors - first).max() < 0.02
    assert np.sqrt(((packet.errors + pulled)[:, :2] ** 2).mean()) < 0.01


def test_a_movement_is_worth_new_statistics_from_a_hundredth_of_a_pixel() -> None:
    assert is_significant(np.array([0.0, 0.02, 0.0, 0.0]))
    assert is_significant(np.array([0.0, 0.0, 0.0, 0.01]))
    assert is_significant(np.array([-0.011, 0.0, 0.0, 0.0]))
    # pitch and roll move the rim, 4 px from the centre
    assert not is_significant(np.array([0.009, -0.009, 0.0, 0.0]))
    assert not is_significant(np.array([0.0, 0.0, 0.002, 0.002]))
    assert is_significant(np.array([0.0, 0.0, 0.003, 0.0]))


def test_pairs_that_are_asked_were_seen() -> None:
    """Refinement samples every third pair; if those are missing, others replace them."""
    pulled = np.tile([0.1, 0.1, 0.0, 0.0], (PAIRS, 1))
    packet = Packet(95, pulled, missing=tuple(range(0, PAIRS, 3)))
    assert packet.refine(192)
    seen = np.arange(PAIRS) % 3 > 0
    assert np.abs(packet.errors[seen, :2] + 0.1).max() < 0.04
    assert [one is None for one in packet.observed.statistics] == (~seen).tolist()


def test_of_nothing_decoded_nothing_is_found() -> None:
    packet = Packet(95, np.tile([0.1, 0.1, 0.0, 0.0], (PAIRS, 1)))
    assert not packet.refine(0)
    assert not packet.moves


def test_poses_of_the_single_mode_stay() -> None:
    """Decision-directed tracking already used the data."""
    single = PacketFormat(SignalSettings(data_pairs=24), Format(mode="single"))
    observed = ObservedPacket([None] * 48, NOISE, single, LedGains.sound(SIDE))
    assert not observed.refine_poses(np.ones((48, 256)), np.zeros((48, 256)), GAIN, NOISE.lit)


SHARP = 1e8 * np.eye(4)


def test_errors_that_are_sharply_seen_are_taken_as_they_are() -> None:
    rng = np.random.default_rng(2)
    error = np.array([0.1, -0.05, 0.002, 0.004]) + rng.normal(0, [0.02, 0.02, 1e-4, 1e-4], (12, 4))
    evidence = {k: (SHARP, SHARP @ error[k]) for k in range(12)}
    assert smoothed_errors(evidence, np.zeros((12, 4))) == pytest.approx(error, abs=1e-4)


def test_errors_are_about_the_poses_as_corrected_before() -> None:
    """Residual errors add to earlier corrections."""
    before = np.tile([0.06, 0.0, 0.0, 0.0], (12, 1))
    rest = np.array([0.04, 0.02, 0.0, 0.0])
    evidence = dict.fromkeys(range(12), (SHARP, SHARP @ rest))
    assert smoothed_errors(evidence, before) == pytest.approx(before + rest, abs=1e-4)


def test_neighbours_share_errors_and_far_pairs_do_not() -> None:
    """Errors vary within 8 pairs or stay constant; the first ten pairs have no evidence."""
    rng = np.random.default_rng(3)
    quick = np.zeros((80, 4))
    quick[40:44, 0] = 0.2
    evidence = {k: (1e4 * np.eye(4), 1e4 * (quick[k] + rng.normal(0, 0.01, 4))) for k in range(10, 80, 3)}
    found = smoothed_errors(evidence, np.zeros((80, 4)))
    assert found[41:43, 0] == pytest.approx([0.2, 0.2], abs=0.07)
    assert np.abs(found[:10, 0]).max() < 0.05
    constant = {k: (1e4 * np.eye(4), 1e4 * np.array([0.2, 0, 0, 0])) for k in range(10, 80, 3)}
    assert smoothed_errors(constant, np.zeros((80, 4)))[:, 0] == pytest.approx(0.2, abs=0.05)


def test_without_evidence_the_corrections_stay() -> None:
    before = np.random.default_rng(4).normal(size=(5, 4))
    assert smoothed_errors({}, before) is before
