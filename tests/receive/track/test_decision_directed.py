"""The single mode at the soft receiver: polarities decided softly, poses by decided data, whole packets."""

from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray
from receive_scenes import draw, frame_of, link, pitch_at
from scipy.special import erf

from heliograph.base.frames import Frame
from heliograph.measure.bench import run_block
from heliograph.receive import Pose
from heliograph.receive.kalman import PoseState
from heliograph.receive.soft.behind import Header
from heliograph.receive.soft.cells import Cells
from heliograph.receive.soft.single import Singles
from heliograph.signal import haar
from heliograph.signal.formats import Format
from heliograph.signal.header import header_levels
from heliograph.signal.packet import PacketFormat
from heliograph.signal.polarity import balance
from heliograph.signal.settings import SignalSettings

Floats = NDArray[np.float64]

SMALL = PacketFormat(SignalSettings(side=8, data_pairs=21), Format(mode="single"))


def by_hand(seen: Floats, mean: Floats) -> tuple[Floats, Floats]:
    """A row of 4 cells, polarity first: LLRs of its data and priors of its cells, summed over polarities and data.

    Each message leaves its own cell's, or datum's, part out.
    """

    def odds(cell: int | None, datum: int | None) -> Floats:
        """Sum of the probabilities for cell (or datum) = +1 and -1."""
        total = np.zeros(2)
        for s, *d in product((1, -1), repeat=4):
            values = [s, *(s * one for one in d)]
            p = 1.0
            for k in range(4):
                p *= 1.0 if k == cell else 1 / (1 + np.exp(-values[k] * seen[k]))
            for k in range(3):
                p *= 1.0 if k == datum else (1 + d[k] * mean[k]) / 2
            shown = values[cell] if cell is not None else d[datum or 0]
            total[0 if shown > 0 else 1] += p
        return total

    data = np.array([np.log(np.divide(*odds(None, k))) for k in range(3)])
    cells = [odds(k, None) for k in range(4)]
    return data, np.array([(a - b) / (a + b) for a, b in cells])


def test_messages_are_those_of_exact_sums() -> None:
    rng = np.random.default_rng(1)
    cells = Cells(SMALL)
    llr = np.zeros((42, 64))
    llr[:, :16] = rng.normal(0, 2, (42, 16))
    means = [rng.uniform(-0.9, 0.9, (42, 12)), np.zeros((42, 32)), np.zeros((42, 16))]
    high = cells.bits(llr, means)[0].reshape(42, 4, 3)
    mean, variance = cells.expected(means, [1 - m**2 for m in means])
    for pattern, row in ((0, 1), (17, 3), (41, 2)):
        seen, data = llr[pattern, :16].reshape(4, 4)[row], means[0][pattern].reshape(4, 3)[row]
        expected, prior = by_hand(seen, data)
        assert high[pattern, row] == pytest.approx(expected, abs=1e-9)
        assert mean[pattern, :16].reshape(4, 4)[row] == pytest.approx(prior, abs=1e-9)
    assert variance[:, :16] == pytest.approx(1 - mean[:, :16] ** 2, abs=1e-9)
    # row 0 has no polarity: cells are data, and its first cell tells nothing
    assert high[:, 0] == pytest.approx(llr[:, 1:4])
    assert mean[:, 1:4] == pytest.approx(means[0][:, :3])
    assert np.all(mean[:, 0] == 0)
    assert np.all(variance[:, 0] == 1)


def test_a_polarity_once_known_stays_known() -> None:
    """Of cells that are known the equaliser says nothing more."""
    cells = Cells(SMALL)
    llr = np.full((42, 64), 30.0)
    none = [np.zeros((42, n)) for n in (12, 32, 16)]
    cells.bits(llr, none)
    known = [np.ones((42, 12)), *none[1:]]
    certain = [np.zeros((42, 12)), np.ones((42, 32)), np.ones((42, 16))]
    for _ in range(3):
        mean, variance = cells.expected(known, certain)
        assert variance[:, 1:4].max() < 1e-3
        assert mean[:, 5:8].min() > 0.999
        llr[:, :16] = 0
        cells.bits(llr, known)


def scene(pose: Pose, levels: Floats, index: int, rng: np.random.Generator) -> Frame:
    """A frame of an array on a dark panel before a bright background: the panel's rim within the LEDs' blur."""
    edge, grid = 9.0 * pose.pitch, np.arange(80)
    across, down = (0.5 * (erf((edge - abs(grid - c)) / 0.75) + 1) for c in (pose.x, pose.y))
    light = 0.45 - 0.43 * down[:, None] * across
    return frame_of(light + 0.8 * draw(pose, levels / 4.0, (0, 0), light.shape), index, rng)


def patterns(count: int, seed: int) -> list[Floats]:
    rng = np.random.default_rng(seed)
    d = rng.choice(np.array([-1, 1], np.int8), (count, 16, 16))
    d[:, :8, :8] = balance(d[:, :8, 1:8])
    return [one.astype(float) for one in haar.encode(d)]


@pytest.fixture(scope="module")
def singles() -> Singles:
    """At 80 m, after a header."""
    rng, header = np.random.default_rng(0), header_levels(7).astype(float)
    pose = Pose(40.2, 39.7, pitch_at(80.0), 0.01, 0.53)
    headers: list[Header] = []
    for k in (0, 2):
        frames = scene(pose, header, k, rng), scene(pose, 4 - header, k + 1, rng)
        headers.append((*frames, (pose, pose)))
    return Singles((0.0, 0.0), headers, 0.8 * 255, np.ones((16, 16)))


def test_a_frame_pulls_a_wrong_pose_back(singles: Singles) -> None:
    """Its data are decided at the wrong pose, and do not confirm it; anywhere on the grid of pixels."""
    rng, steps = np.random.default_rng(3), []
    for k, levels in enumerate(patterns(12, 4)):
        x, y = 40 + rng.uniform(-0.5, 0.5, 2)
        pose = Pose(x, y, pitch_at(80.0), 0.01, 0.53)
        frame = scene(pose, levels, 10 + k, rng)
        at = np.concatenate([pose.moved(0.06, -0.04).vector(), [0.8 * 255], singles._behind])
        for _ in range(2):
            matrix, rhs, score = singles._equations(frame, PoseState.start(frame.time_s, at[:5], np.eye(5)), at)
            spreads = np.array([1, 1, 0.002, 0.002, 0.02, 2, *[5] * 4])
            at = at + np.linalg.solve(matrix + np.diag(spreads**-2.0), rhs)
        steps.append(at[:2] - (pose.x, pose.y))
        assert score > 0.9
    assert np.sqrt(np.mean(np.square(steps))) < 0.02
    assert np.abs(np.mean(steps, 0)).max() < 0.01


def test_what_is_behind_is_learnt(singles: Singles) -> None:
    rng = np.random.default_rng(5)
    pose = Pose(40.4, 40.3, pitch_at(80.0), 0.01, 0.53)
    dark = scene(pose, np.zeros((16, 16)), 50, rng)

    state = PoseState.start(dark.time_s, pose.vector(), np.eye(5))
    left = 0.5 * singles._glance(dark, state).change
    # 114 gray levels of background, 5 of panel
    assert np.abs(left).mean() < 4


def test_the_panels_width_is_told_by_the_header(singles: Singles) -> None:
    """9 pitches each way in the scene; a rim half a pitch off would pull the pitch by 5 %."""
    assert singles._half == pytest.approx(9, abs=0.15)


@pytest.mark.parametrize(("rates", "distance_m"), [("1/2", 60.0), ("9/10", 40.0)])
def test_packets_without_inverses_are_read(rates: str, distance_m: float) -> None:
    named = f"[{{mode='single', high='{rates}', middle='{rates}', low='{rates}'}}, {{}}]"
    settings = link(f"transmit.formats={named}", "receive.receiver=soft", distance_m=distance_m)
    counts = run_block(settings, 1, max_packets=2)
    assert {n: (c.codewords, c.codeword_errors) for n, c in counts.layers.items()} == {
        "high": (2, 0),
        "middle": (4, 0),
        "low": (2, 0),
    }
    assert counts.false_codewords == 0


def test_rates_of_167_kb_s_are_read_at_80_m() -> None:
    """Near the limit of the channel: a clock off by some hundredths of a pattern would lose most of it."""
    named = "[{mode='single', high='9/10', middle='3/4', low='1/2'}]"
    counts = run_block(link(f"transmit.formats={named}", "receive.receiver=soft", distance_m=80.0), 1, max_packets=1)
    assert [(c.codewords, c.codeword_errors) for c in counts.layers.values()] == [(1, 0), (2, 0), (1, 0)]
    assert counts.layers["high"].raw_errors < 0.01 * counts.layers["high"].raw_bits


def test_a_moving_array_is_followed_without_inverses() -> None:
    """At 50 km/h on a rough road, packet after packet; the dimmed header leaves the gain as it is."""
    settings = link(
        "transmit.formats=[{mode='single', high='1/2', middle='1/2', low='1/2'}]",
        "receive.receiver=soft",
        distance_m=52.0,
        speed_m_s=14.0,
        stop_m=46.0,
        shake="road",
        road_class="C",
    )
    counts = run_block(settings, 1, max_packets=2)
    assert counts.layers["high"].codewords == 2
    assert sum(layer.codeword_errors for layer in counts.layers.values()) == 0


@pytest.mark.parametrize("place", [{"yaw_deg": 30.0}, {"dead": 0.05}])
def test_tilt_and_dead_leds_are_known_from_headers(place: dict[str, float]) -> None:
    settings = link(
        "transmit.formats=[{mode='single', high='1/2', middle='1/2', low='1/2'}]",
        "receive.receiver=soft",
        distance_m=50.0,
        arrays=[{"x_m": 0.0, "y_m": 0.0, **place}],
    )
    counts = run_block(settings, 1, max_packets=2)
    assert counts.layers["high"].codewords == 2
    assert [layer.codeword_errors for layer in counts.layers.values()] == [0, 0, 0]
    assert counts.false_codewords == 0


@pytest.mark.parametrize("seed", [2, 7])
def test_dimmed_headers_do_not_turn_the_array(seed: int) -> None:
    """A tilt and dead LEDs were seen where the header's second pair is dimmed on one side."""
    named = "[{mode='single', high='9/10', middle='3/4', low='1/2'}]"
    counts = run_block(link(f"transmit.formats={named}", "receive.receiver=soft", distance_m=70.0), seed, max_packets=1)
    assert [(c.codewords, c.codeword_errors) for c in counts.layers.values()] == [(1, 0), (2, 0), (1, 0)]
