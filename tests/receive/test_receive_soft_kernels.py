"""The soft receiver's kernels, looks and equaliser against whole matrices."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from receive_scenes import SIDE, draw, pitch_at

from heliograph.base.frames import Frame
from heliograph.receive import Pose
from heliograph.receive.soft import glance, kernels, reference
from heliograph.receive.soft.equalise import KNOWN, equalise, products
from heliograph.receive.soft.glance import take_glance
from heliograph.receive.soft.look import Look, gram_of, weigh
from heliograph.receive.soft.noise import Noise, measure_noise
from heliograph.signal import haar
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

Floats = NDArray[np.float64]

CELLS = SIDE * SIDE
SHAPE = (40, 44)
GAIN = 150.0
T = reference.transform(SIDE)
CUT = 5e-4
"""What is left of an LED's light beyond `kernels.REACH` standard deviations, both axes."""

POSES = [
    Pose(21.3, 19.6, pitch_at(100), 0.0, 0.51),
    Pose(20.8, 20.2, pitch_at(60), 0.03, 0.53),
    Pose(21.0, 18.9, 1.9, -0.4, 0.9),
    Pose(3.0, 38.0, 1.1, 0.1, 0.6),
]
"""The last lies partly beyond the window."""


def placed(pose: Pose) -> glance.Shares:
    return glance.placed(pose, (0, 0), SHAPE, SIDE)


def cell_matrix(pose: Pose) -> Floats:
    return reference.blur_matrix(pose, SIDE, (0, 0), SHAPE) @ T


def test_transform_is_that_of_the_signal() -> None:
    rng = np.random.default_rng(0)
    form = PacketFormat(SignalSettings(data_pairs=8))
    cells = rng.choice(np.array([-1, 1], np.int8), (8, CELLS))
    levels = haar.encode(form.join(cells))
    assert np.allclose(cells @ T.T, levels.reshape(8, -1) / 2.0 - 1.0)
    assert np.allclose(T.T @ T, np.eye(CELLS) / 4)


def test_blur_matrix_is_the_image_of_each_led() -> None:
    x, pose = np.random.default_rng(1).random((SIDE, SIDE)), POSES[1]
    a = reference.blur_matrix(pose, SIDE, (3, 2), SHAPE)
    assert np.allclose(a @ x.ravel(), draw(pose, x, (3, 2), SHAPE).ravel(), atol=1e-12)


@pytest.mark.parametrize("pose", POSES)
def test_light_of_cells(pose: Pose) -> None:
    cells = np.random.default_rng(2).normal(size=CELLS)
    image = np.zeros(SHAPE)
    kernels.shine(kernels.leds(cells), *placed(pose), image)
    assert image.ravel() == pytest.approx(cell_matrix(pose) @ cells, abs=CUT * np.abs(cells).max())
    kernels.shine(kernels.leds(cells), *placed(pose), image)
    assert image.ravel() == pytest.approx(2 * cell_matrix(pose) @ cells, abs=2 * CUT * np.abs(cells).max())


@pytest.mark.parametrize("pose", POSES)
def test_cells_see_an_image(pose: Pose) -> None:
    image, out = np.random.default_rng(3).normal(size=SHAPE), np.empty(CELLS)
    kernels.seen_by_cells(image, *placed(pose), out)
    want = cell_matrix(pose).T @ image.ravel()
    assert out == pytest.approx(want, abs=2 * CUT)
    assert np.abs(want).max() > 100 * CUT


@pytest.mark.parametrize("pose", POSES)
def test_gram(pose: Pose) -> None:
    out = gram_of(placed(pose), SHAPE)
    want = cell_matrix(pose).T @ cell_matrix(pose)
    assert np.abs(out - want).max() < 4 * CUT * want.max()
    assert np.abs(out - out.T).max() < 1e-6 * want.max()
    light = np.zeros((*SHAPE, CELLS), np.float32)
    kernels.light(*placed(pose), light)
    assert np.abs(light.reshape(-1, CELLS) - cell_matrix(pose)).max() < CUT


@pytest.mark.parametrize("motion", [(0.0, 0.0), (0.3, -0.2), (1.2, 0.6)])
@pytest.mark.parametrize("pose", POSES[:3])
def test_difference_of_two_poses(pose: Pose, motion: tuple[float, float]) -> None:
    a, b = (reference.blur_matrix(p, SIDE, (0, 0), SHAPE) for p in (pose, pose.moved(*motion)))
    got = kernels.difference(*placed(pose), *placed(pose.moved(*motion)))
    assert got == pytest.approx(((a - b) ** 2).sum(), rel=0.01, abs=1e-9)


def pair(poses: tuple[Pose, Pose], x: Floats, corner: tuple[int, int] = (0, 0), noise: float = 0.0) -> list[Frame]:
    """A pattern and its inverse without a sensor: gray levels as they are."""
    rng = np.random.default_rng(4)
    light = [30 + GAIN * draw(p, y, (0, 0), (60, 60)) for p, y in zip(poses, (x, 1 - x), strict=True)]
    return [
        Frame(k, k * 1e-3, image + rng.normal(0, noise, image.shape), 8, corner)  # type: ignore[arg-type]
        for k, image in enumerate(light)
    ]


def random_levels() -> tuple[Floats, Floats]:
    """Cells, and the LEDs' levels 0 to 1 they make."""
    cells = np.random.default_rng(5).choice([-1.0, 1.0], CELLS)
    return cells, 0.5 * (1 + T @ cells).reshape(SIDE, SIDE)


MOTIONS = [(0.0, 0.0), (0.12, -0.2)]
ROLLS = [0.0, 0.05]


def moving(z: float, roll: float, motion: tuple[float, float]) -> tuple[Pose, Pose]:
    first = Pose(29.3, 30.4, pitch_at(z), roll, 0.51)
    return first, first.moved(*motion)


class Whole:
    """A glance as whole matrices."""

    def __init__(self, poses: tuple[Pose, Pose], frames: list[Frame], noise: Noise):
        self.glance = take_glance(frames[0], frames[1], poses, SIDE)
        corner, shape = self.glance.corner, self.glance.change.shape
        a = [reference.blur_matrix(pose, SIDE, corner, shape) for pose in poses]
        self.b, self.o = reference.pair_model(a[0], a[1], T)
        middle = self.glance.middle
        spread = abs(poses[1].x - poses[0].x) / 2, abs(poses[1].y - poses[0].y) / 2
        wide = reference.blur_matrix(middle, SIDE, corner, shape, spread)
        self.w = reference.weights(wide, middle.pitch, noise.lit, noise.dark, 2, shape)
        self.d = self.glance.change.ravel()


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("roll", ROLLS)
def test_difference_of_a_pair_is_that_of_the_model(roll: float, motion: tuple[float, float]) -> None:
    cells, x = random_levels()
    poses = moving(80, roll, motion)
    whole = Whole(poses, pair(poses, x), Noise(4.0, 4.0))
    assert whole.d == pytest.approx(GAIN * (whole.b @ cells + whole.o), abs=1e-9)


@pytest.mark.parametrize("noise", [Noise(4.5, 4.5), Noise(4.5, 1.4), Noise(3.0, 9.0)])
@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("roll", ROLLS)
def test_look_is_what_remains_of_the_pixels(roll: float, motion: tuple[float, float], noise: Noise) -> None:
    _, x = random_levels()
    poses = moving(80, roll, motion)
    whole = Whole(poses, pair(poses, x, noise=2.0), noise)
    got, w = weigh(whole.glance, noise, SIDE).look(), whole.w
    # a roll or the light beyond the reach of the kernels is not in the weights' profile to the last digit
    scale = float(w.max())
    assert np.abs(got.gram - whole.b.T @ (w[:, None] * whole.b)).max() < 4 * CUT * scale
    assert np.abs(got.seen - whole.b.T @ (w * whole.d)).max() < 4 * CUT * scale * np.abs(whole.d).max()
    assert np.abs(got.offset - whole.b.T @ (w * whole.o)).max() < 4 * CUT * scale
    assert got.cross == pytest.approx(float(whole.d @ (w * whole.o)), abs=2e-2 * scale * np.abs(whole.d).max())
    assert got.drift == pytest.approx(float(whole.o @ (w * whole.o)), rel=2e-2, abs=1e-3)
    if motion == (0.0, 0.0):
        assert not got.offset.any()


@pytest.mark.parametrize("scattered", [False, True])
@pytest.mark.parametrize("unknown", [1, 63, 64, 128, 200])
def test_covariance_of_any_number_of_cells(unknown: int, scattered: bool) -> None:
    """Sizes that are padded and sizes that are not."""
    whole = Whole(moving(90, 0.0, (0.0, 0.0)), pair(moving(90, 0.0, (0.0, 0.0)), random_levels()[1]), Noise(4.0, 4.0))
    view, cells = weigh(whole.glance, Noise(4.0, 4.0), SIDE).look(), random_levels()[0]
    which = np.sort(np.random.default_rng(8).permutation(CELLS)[:unknown]) if scattered else np.arange(unknown)
    variance = np.where(np.isin(np.arange(CELLS), which), 0.7, 0.0)
    got = equalise(view, GAIN, 4.0, np.where(variance > 0, 0.0, cells), variance)
    gram = view.gram[np.ix_(which, which)].astype(np.float64)
    want = np.linalg.inv(GAIN**2 / 4.0 * gram + np.eye(unknown) / 0.7)
    assert np.abs(got.covariance - want).max() < 1e-5
    assert got.trace == pytest.approx(float(np.trace(gram @ want)), rel=1e-3)


@pytest.mark.parametrize("unknown", [0, 1, 64, 150])
@pytest.mark.parametrize("motion", MOTIONS)
def test_products_before_the_light_of_cells(motion: tuple[float, float], unknown: int) -> None:
    poses, scale, rng = moving(80, 0.02, motion), GAIN**2 / 4.0, np.random.default_rng(9)
    weighted = weigh(Whole(poses, pair(poses, random_levels()[1]), Noise(4.0, 4.0)).glance, Noise(4.0, 4.0), SIDE)
    which, images = np.sort(rng.permutation(CELLS)[:unknown]), rng.normal(size=(7, *weighted.change.shape))
    got = products(weighted, weighted.look(), images, which, scale)
    flat = images.reshape(7, -1)
    # B by the cells' correlations with single pixels, B^T B as the look has it
    pixels = np.eye(flat.shape[1]).reshape(-1, *weighted.change.shape)
    b = np.stack([weighted.correlated(pixel) for pixel in pixels])[:, which]
    gram = weighted.look().gram[np.ix_(which, which)].astype(np.float64)
    want = flat @ (flat.T - b @ np.linalg.solve(gram + np.eye(unknown) / scale, b.T @ flat.T))
    assert np.abs(got - want).max() < 1e-5 * want.max()
    if motion == (0.0, 0.0):
        noise = np.eye(flat.shape[1]) + scale * b @ b.T
        assert got == pytest.approx(flat @ np.linalg.solve(noise, flat.T), abs=2e-3 * want.max())


def test_what_moves_behind_is_taken_off_by_its_slopes() -> None:
    rng = np.random.default_rng(10)
    change, total, lit, got = *rng.normal(size=(3, 9, 7)), np.empty((9, 7))
    kernels.steadied(change, total, lit, 3.0, 0.2, -0.4, got)
    down, right = np.gradient(0.5 * (total - 3.0 * lit))
    assert got == pytest.approx(change - 0.2 * right + 0.4 * down)


def whole_look(b: Floats, d: Floats, o: Floats, w: Floats) -> Look:
    """A look by whole matrices."""
    gram = (b.T @ (w[:, None] * b)).astype(np.float32)
    return Look(gram, b.T @ (w * d), b.T @ (w * o), float(d @ (w * o)), float(o @ (w * o)))


def priors(kind: str) -> tuple[Floats, Floats]:
    """Mean and variance of each cell before."""
    rng = np.random.default_rng(6)
    mean = {"nothing": np.zeros(CELLS), "something": np.tanh(rng.normal(0, 1.5, CELLS))}.get(kind)
    if mean is None:  # the high layer is known
        mean = np.where(np.arange(CELLS) < CELLS // 4, random_levels()[0], 0.0)
    return mean, np.where(np.abs(mean) == 1, 0.0, np.maximum(1 - mean**2, 2 * KNOWN))


@pytest.mark.parametrize("kind", ["nothing", "something", "the high layer"])
@pytest.mark.parametrize("z", [60, 110])
def test_equaliser_is_the_linear_mmse_estimate(z: float, kind: str) -> None:
    cells, x = random_levels()
    noise, poses = Noise(4.5, 1.4), moving(z, 0.02, (0.1, 0.05))
    whole = Whole(poses, pair(poses, x, noise=1.5), noise)
    used = whole.w > 0
    b, d, o, w = whole.b[used], whole.d[used], whole.o[used], whole.w[used]
    mean, variance = priors(kind)
    got = equalise(whole_look(b, d, o, w), GAIN, noise.lit, mean, variance)
    want = reference.lmmse(GAIN * b, d - GAIN * o, noise.lit / w, mean, variance)
    open_ = variance > 0
    assert got.mean == pytest.approx(want.mean, abs=2e-3)
    assert got.llr[open_] == pytest.approx(want.extrinsic[open_], abs=0.03, rel=0.01)
    assert not got.llr[~open_].any()
    trace = float(np.trace(b.T @ (w[:, None] * b) @ want.covariance))
    assert got.trace == pytest.approx(trace, rel=2e-3)
    # and it is worth the name: most cells of the layer that shows best are right
    assert np.mean((got.llr > 0) == (cells > 0), where=open_) > 0.6


def test_all_cells_known_leave_nothing_to_estimate() -> None:
    cells, x = random_levels()
    poses = moving(80, 0.0, (0.0, 0.0))
    whole = Whole(poses, pair(poses, x), Noise(4.0, 4.0))
    got = equalise(weigh(whole.glance, Noise(4.0, 4.0), SIDE).look(), GAIN, 4.0, cells, np.zeros(CELLS))
    assert np.array_equal(got.mean, cells)
    assert got.trace == 0
    assert not got.llr.any()


# unaware of the motion it would find 12.3 in place of 8 at 60 m
@pytest.mark.parametrize(("motion", "error"), [((0.0, 0.0), 0.06), ((0.05, 0.1), 0.12), ((0.2, 0.2), 0.3)])
@pytest.mark.parametrize(("inside", "beside"), [(2.0, 2.0), (1.5, 0.8)])
@pytest.mark.parametrize("z", [60, 100, 150])
def test_noise_is_measured(z: float, inside: float, beside: float, motion: tuple[float, float], error: float) -> None:
    rng = np.random.default_rng(7)
    glances = []
    for _ in range(48):
        x = 0.5 * (1 + T @ rng.choice([-1.0, 1.0], CELLS)).reshape(SIDE, SIDE)
        poses = moving(z, 0.02, motion)
        frames = pair(poses, x)
        lit = draw(poses[0], np.ones((SIDE, SIDE)), (0, 0), (60, 60))
        sigma = np.sqrt(beside**2 + (inside**2 - beside**2) * np.clip(lit, 0, 1))
        noisy = [replace(f, pixels=f.pixels + rng.normal(0, sigma)) for f in frames]  # type: ignore[arg-type]
        glances.append(take_glance(noisy[0], noisy[1], poses, SIDE))
    noise = measure_noise(glances, GAIN, SIDE)
    # of a difference of two frames
    assert noise.lit == pytest.approx(2 * inside**2, rel=error)
    assert noise.dark == pytest.approx(2 * beside**2, rel=0.06)
