"""Alternation of frames, busy blocks and the coarse search against the NumPy reference."""

from collections.abc import Sequence
from typing import Any

import detect_oracle as reference
import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import SIDE

from heliograph.base.frames import Frame
from heliograph.receive.detect import alternation, kernels
from heliograph.receive.detect.alternation import ALTERNATION, DETECT, DIFFERENCE, FrameWeights
from heliograph.receive.geometry.pose import Pose
from heliograph.signal.header import all_header_cells


@pytest.mark.parametrize(
    "weights", [ALTERNATION, DIFFERENCE, (2.0, -4.0, 4.0, -2.0), (2.0, -2.5, 2.5, -2.0), (9.0, 9.0, 9.0, 9.0)]
)
@pytest.mark.parametrize("lit", [(0, 255, 0, 255), (255, 255, 255, 255), None])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_combined_frames_equal_the_reference(dtype: type, lit: tuple[int, ...] | None, weights: FrameWeights) -> None:
    pixels: NDArray[Any] = np.random.default_rng(0).integers(0, np.iinfo(dtype).max + 1, (4, 21, 29)).astype(dtype)
    if lit:
        pixels[:] = np.reshape(lit, (4, 1, 1))
    got, means = np.empty((21, 29), np.float32), np.empty((3, 4), np.float32)
    kernels.combined(*pixels, np.array(weights, np.float32), got)
    kernels.combined_means(*pixels, np.array(weights, np.float32), 8, means)
    want = np.tensordot(weights, pixels.astype(float), 1)
    assert np.array_equal(got, want.astype(np.float32))
    assert means == pytest.approx(reference.block_means(np.pad(want, ((0, 3), (0, 3))), 8), rel=1e-5)
    # integer means of 8 bit frames equal float means
    frames = [Frame(k, k * 1e-3, one, 8 * one.itemsize) for k, one in enumerate(pixels)]
    assert np.array_equal(alternation.alternation_means(frames, weights), means)


def test_alternation_cancels_even_acceleration() -> None:
    base, rate = np.random.default_rng(0).integers(0, 40, (2, 9, 11))
    frames = [Frame(t, t * 1e-3, np.asarray(base + rate * t + 3 * t * t, np.uint8)) for t in range(4)]
    assert [alternation.alternation_of(part).any() for part in (frames, frames[:2])] == [False, True]


BLOCKS = (20, 40)
LARGE = Pose(100.0, 80.0, 12.0, 0.0, 0.6)  # spans the frame height and more than half of the blocks


def busy(means: np.ndarray, tracked: list[Pose]) -> np.ndarray:
    frame = Frame(0, 0.0, np.zeros((160, 320), np.uint8))
    return alternation.busy_blocks(means.astype(np.float32), frame, tracked, SIDE, 0.03)


def test_an_array_near_a_large_tracked_array_is_busy() -> None:
    means = np.full(BLOCKS, 1.0)
    # a bright region seen through the windscreen
    means[:, :25], means[10, 35] = 60.0, 30.0
    assert np.argwhere(busy(means, [LARGE])).tolist() == [[i, j] for i in (9, 10, 11) for j in (34, 35, 36)]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("tracked", "covered"), [
    ([], []),
    ([Pose(60.0, 60.0, 1.0)], [(slice(5, 10), slice(5, 10))]),
    # overlapping arrays; the second extends beyond the frame
    ([LARGE, Pose(4.0, 80.0, 3.0)], [(slice(0, 20), slice(0, 26)), (slice(5, 15), slice(0, 5))]),
])  # fmt: skip
def test_busy_blocks_equal_the_reference(tracked: list[Pose], covered: list[tuple[slice, slice]], seed: int) -> None:
    means, free = np.random.default_rng(seed).gamma(4.0, 0.6, BLOCKS).astype(np.float32), np.ones(BLOCKS, bool)
    for blocks in covered:
        free[blocks] = False
    want = reference.busy(means.astype(float), free, DETECT.busy_contrast * 0.03 * 255, DETECT.busy_ratio)
    assert want.any()
    assert np.array_equal(busy(means, tracked), want)


def last_pixels(part: Sequence[Frame]) -> NDArray[np.float32]:
    return part[-1].pixels.astype(np.float32)


@pytest.mark.parametrize("place", [(0, 0), (9, 12), (4, 6)])
def test_a_region_holds_the_surroundings_of_a_busy_block(place: tuple[int, int]) -> None:
    pixels, busy = np.random.default_rng(3).integers(0, 256, (4, 77, 101), np.uint8), np.zeros((10, 13), bool)
    busy[place] = True
    frames = [Frame(k, k * 1e-3, one, origin=(5, 7)) for k, one in enumerate(pixels)]
    [(change, blocks)] = alternation.search_regions(frames, busy, 16.0, last_pixels)
    x, y = change.origin[0] - 5, change.origin[1] - 7
    rows, columns = change.pixels.shape
    assert np.array_equal(change.pixels, pixels[-1, y : y + rows, x : x + columns])
    assert np.argwhere(blocks).tolist() == [[place[0] - y / 8, place[1] - x / 8]]
    # at least 16 px around the block, clipped to the frame
    for first_px, count, block, size in ((y, rows, place[0], 77), (x, columns, place[1], 101)):
        assert first_px <= max(8 * block - 16, 0)
        assert first_px + count >= min(8 * block + 24, size)


def test_distant_blocks_have_separate_regions() -> None:
    frame, busy = Frame(0, 0.0, np.zeros((512, 1024), np.uint8), origin=(3, 1)), np.zeros((64, 128), bool)
    for place in ((2, 3), (4, 4), (40, 120), (60, 60)):
        busy[place] = True
    regions, found = alternation.search_regions([frame], busy, 32.0, last_pixels), np.zeros((64, 128), int)
    assert sorted(int(blocks.sum()) for _, blocks in regions) == [1, 1, 2]
    for change, blocks in regions:
        x, y = (change.origin[0] - 3) // 8, (change.origin[1] - 1) // 8
        found[y : y + len(blocks), x : x + blocks.shape[1]] += blocks
        assert blocks.shape == tuple(-(-size // 8) for size in change.pixels.shape)
    assert np.array_equal(found, busy)
    assert sum(change.pixels.size for change, _ in regions) < 0.1 * frame.pixels.size
    # with busy blocks everywhere, regions would cost as much as the full frame
    busy[::6, ::6] = True
    assert len(alternation.search_regions([frame], busy, 32.0, last_pixels)) == 1


CELLS = all_header_cells().reshape(-1, 16).astype(float)


def noisy_headers(pixels: int) -> NDArray[np.float32]:
    """Return two noisy headers, the second inverted; the first has identity 9 and its corner at (8, 10)."""
    image, size = np.random.default_rng(1).normal(0, 4, (44, 52)).astype(np.float32), 4 * pixels
    for identity, contrast, y, x in ((9, 30, 10, 8), (11, -22, 24, 31)):
        image[y : y + size, x : x + size] += contrast * np.kron(all_header_cells()[identity], np.ones((pixels, pixels)))
    return image


def searched(
    image: NDArray[np.float32], busy: NDArray[np.bool_], grid: reference.Grid, corner: tuple[float, float] = (0.0, 0.0)
) -> NDArray[np.float64]:
    best, sums, limits = np.zeros((grid.count, 5)), alternation.integral_images(image), (grid.contrast, grid.threshold)
    places = grid.ring, grid.step, np.array(corner)
    args = (
        CELLS,
        np.ascontiguousarray(CELLS.T, np.float32),
        grid.sides,
        (*limits, 2.0, grid.apart),
        *places,
        0,
        1 << 60,
        best,
    )
    found, _, passed, _ = kernels.search(sums, busy, *args)
    assert passed == busy.size
    return best[:found]


# half the side is no multiple of the step; otherwise rounding decides overlaps
@pytest.mark.parametrize(("pixels", "sides", "count"), [(2, (8.3, 9.1), 5), (4, (11.3, 15.8), 1)])
@pytest.mark.parametrize("turned", [False, True])
def test_search_equals_the_reference(pixels: int, sides: tuple[float, ...], count: int, turned: bool) -> None:
    image, busy = noisy_headers(pixels), np.ones((6, 7), bool)
    busy[(slice(2, 4), slice(3, None)) if turned else (slice(None), 4) if count == 1 else 0] = False
    apart = DETECT.min_distance_turned if turned else DETECT.min_distance
    grid = reference.Grid(np.array(sides), count, apart=apart)
    best = searched(image, busy, grid)
    want = reference.search(image.astype(float), busy, 8, CELLS, grid)
    assert best == pytest.approx(np.array(want), rel=1e-6)
    # enough busy blocks give all requested candidates
    assert len(best) == count or (turned or count == 1)
    assert best[0, 4] == 9
    assert np.abs(best[0, 1:3] - (8 + 2 * pixels, 10 + 2 * pixels)).max() < 1


@pytest.mark.parametrize(("busy", "contrast", "count"), [(False, 1.0, 0), (True, 200.0, 0), (True, 1.0, 5)])
def test_only_busy_blocks_with_contrast_are_searched(busy: bool, contrast: float, count: int) -> None:
    image = np.random.default_rng(0).normal(0, 30, (40, 48)).astype(np.float32)
    grid = reference.Grid(np.array([12.0]), 5, contrast, 0.0)
    assert len(searched(image, np.full((5, 6), busy), grid)) == count


@pytest.mark.parametrize(("left", "top"), [(0, 0), (3, 2), (5, 7)])
def test_the_search_grid_is_fixed_to_the_sensor(left: int, top: int) -> None:
    image, grid = noisy_headers(4)[top:, left:].copy(), reference.Grid(np.array([15.8]), 1)
    ((_, x, y, side, _),) = searched(image, np.ones((6, 7), bool), grid, (left, top))
    # the ring corner lies on the sensor grid
    corner = (np.array([x + left, y + top]) - side / 2 - DETECT.ring * side) / (0.1 * side)
    assert corner == pytest.approx(np.round(corner), abs=1e-6)
