"""Detector kernels against the NumPy reference."""

from collections.abc import Sequence

import detect_oracle as reference
import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.detect import alternation as coarse
from heliograph.receive.detect import alternation as parts
from heliograph.receive.detect import kernels
from heliograph.signal.header import all_header_cells

RING, GRID = 0.12, 0.1
UNBOUNDED = 1 << 60


@pytest.mark.parametrize("weights", [coarse.ALTERNATION, coarse.DIFFERENCE, (2.0, -4.0, 4.0, -2.0)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_frames_combined(dtype: type, weights: coarse.FrameWeights) -> None:
    top = 256 if dtype is np.uint8 else 65536
    f0, f1, f2, f3 = np.random.default_rng(0).integers(0, top, (4, 13, 21)).astype(dtype)
    got, means = np.empty((13, 21), np.float32), np.empty((2, 3), np.float32)
    kernels.combined(f0, f1, f2, f3, np.array(weights, np.float32), got)
    kernels.combined_means(f0, f1, f2, f3, np.array(weights, np.float32), 8, means)
    want = reference.combined(np.array([f0, f1, f2, f3], float), np.array(weights))
    assert np.array_equal(got, want.astype(np.float32))
    padded = np.pad(want, ((0, 3), (0, 3)))
    assert means == pytest.approx(reference.block_means(padded, 8), rel=1e-5)


@pytest.mark.parametrize(
    "weights",
    [coarse.ALTERNATION, coarse.DIFFERENCE, (2.0, -4.0, 4.0, -2.0), (2.0, -2.5, 2.5, -2.0), (9.0, 9.0, 9.0, 9.0)],
)
@pytest.mark.parametrize("lit", [(255, 0, 255, 0), (0, 255, 0, 255), (255, 255, 255, 255), None])
def test_means_in_integers_are_those_of_floats(weights: coarse.FrameWeights, lit: tuple[int, ...] | None) -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (4, 21, 29), np.uint8)
    if lit:
        pixels[:] = np.reshape(lit, (4, 1, 1))
    got = coarse.alternation_means([Frame(k, k * 1e-3, one) for k, one in enumerate(pixels)], weights)
    want = np.empty((3, 4), np.float32)
    kernels.combined_means(*pixels, np.array(weights, np.float32), 8, want)
    assert np.array_equal(got, want)


def test_alternation_cancels_even_acceleration() -> None:
    base, rate = np.random.default_rng(0).integers(0, 40, (2, 9, 11))
    frames = [Frame(t, t * 1e-3, np.asarray(base + rate * t + 3 * t * t, np.uint8)) for t in range(4)]
    assert not coarse.alternation_of(frames).any()
    assert coarse.alternation_of(frames[:2]).any()


def last_pixels(part: Sequence[Frame]) -> NDArray[np.float32]:
    return part[-1].pixels.astype(np.float32)


@pytest.mark.parametrize("place", [(0, 0), (9, 12), (4, 6)])
def test_the_part_searched_holds_what_it_should(place: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    frames = [Frame(k, k * 1e-3, rng.integers(0, 256, (77, 101), np.uint8), origin=(5, 7)) for k in range(4)]
    busy = np.zeros((10, 13), bool)
    busy[place] = True
    [(change, blocks, first)] = parts.search_regions(frames, busy, 16.0, last_pixels)
    x, y = first.origin[0] - 5, first.origin[1] - 7
    assert x % 8 == 0
    assert y % 8 == 0
    rows, columns = first.pixels.shape
    assert np.array_equal(first.pixels, frames[0].pixels[y : y + rows, x : x + columns])
    assert np.array_equal(change, frames[-1].pixels[y : y + rows, x : x + columns])
    assert blocks[place[0] - y // 8, place[1] - x // 8]
    assert blocks.sum() == 1
    # at least 16 px around the block, clipped to the frame
    assert y <= max(8 * place[0] - 16, 0)
    assert y + rows >= min(8 * place[0] + 24, 77)
    assert x <= max(8 * place[1] - 16, 0)
    assert x + columns >= min(8 * place[1] + 24, 101)


def test_blocks_far_from_each_other_are_searched_in_parts_of_their_own() -> None:
    frame, busy = Frame(0, 0.0, np.zeros((512, 1024), np.uint8), origin=(3, 1)), np.zeros((64, 128), bool)
    busy[2, 3] = busy[4, 4] = busy[40, 120] = busy[60, 60] = True
    found_parts = parts.search_regions([frame], busy, 32.0, last_pixels)
    assert sorted(int(part.busy.sum()) for part in found_parts) == [1, 1, 2]
    found = np.zeros((64, 128), int)
    for part in found_parts:
        x, y = (part.first.origin[0] - 3) // 8, (part.first.origin[1] - 1) // 8
        down, across = part.busy.shape
        found[y : y + down, x : x + across] += part.busy
        assert part.change.shape == part.first.pixels.shape
    assert np.array_equal(found, busy)
    assert sum(part.change.size for part in found_parts) < 0.1 * frame.pixels.size
    # with busy blocks everywhere, regions would cost as much as the full frame
    busy[::6, ::6] = True
    assert len(parts.search_regions([frame], busy, 32.0, last_pixels)) == 1


def headers(seed: int, pixels: int) -> NDArray[np.float32]:
    """Return two noisy headers, one inverted; the first has identity 7 seed + 2 and its corner at (8, 10)."""
    image = np.random.default_rng(seed).normal(0, 4, (44, 52)).astype(np.float32)
    cells, size = all_header_cells(), 4 * pixels
    image[10 : 10 + size, 8 : 8 + size] += 30 * np.kron(cells[7 * seed + 2], np.ones((pixels, pixels)))
    image[24 : 24 + size, 31 : 31 + size] -= 22 * np.kron(cells[7 * seed + 4], np.ones((pixels, pixels)))
    return image


def searched(
    image: NDArray[np.float32],
    busy: NDArray[np.bool_],
    sides: tuple[float, ...],
    count: int,
    *,
    contrast: float,
    threshold: float,
    apart: float = coarse.DETECT.min_distance,
    corner: tuple[float, float] = (0.0, 0.0),
) -> tuple[int, NDArray[np.float64]]:
    """Return the number of candidates and the candidate table."""
    cells, best = all_header_cells().reshape(-1, 16).astype(float), np.zeros((count, 5))
    sums = coarse.integral_images(image)
    sizes, first = np.array(sides), np.array(corner)
    found, _, passed, _ = kernels.search(
        sums,
        busy,
        8.0,
        cells,
        sizes,
        contrast,
        threshold,
        2.0,
        RING,
        GRID,
        apart,
        first,
        0,
        UNBOUNDED,
        best,
    )
    assert passed == busy.size
    return found, best


# half the side is no multiple of the step; otherwise rounding decides overlaps
@pytest.mark.parametrize(("pixels", "sides", "count"), [(2, (8.3, 9.1), 5), (4, (11.3, 15.8), 1)])
@pytest.mark.parametrize("quiet", [(0, slice(None)), (slice(None), 4), (slice(2, 4), slice(3, None))])
@pytest.mark.parametrize("apart", [coarse.DETECT.min_distance, coarse.DETECT.min_distance_turned])
@pytest.mark.slow
def test_search_finds_what_the_reference_finds(
    apart: float, quiet: tuple[int | slice, ...], pixels: int, sides: tuple[float, ...], count: int
) -> None:
    image, cells = headers(1, pixels), all_header_cells().reshape(-1, 16).astype(float)
    busy = np.ones((6, 7), dtype=bool)
    busy[quiet] = False
    found, best = searched(image, busy, sides, count, contrast=3.0, threshold=0.35, apart=apart)
    grid = reference.Grid(
        sides=np.array(sides), contrast=3.0, threshold=0.35, ring=RING, step=GRID, apart=apart, count=count
    )
    want = reference.search(image.astype(float), busy, 8, cells, grid)
    assert found == len(want)
    # enough busy blocks give all requested candidates
    assert found == count or quiet[0] != 0
    assert best[:found] == pytest.approx(np.array(want), rel=1e-6)
    assert best[0, 4] == 9
    assert abs(best[0, 1] - 8 - 2 * pixels) < 1
    assert abs(best[0, 2] - 10 - 2 * pixels) < 1


def test_search_keeps_out_of_quiet_blocks() -> None:
    image = np.random.default_rng(0).normal(0, 30, (40, 48)).astype(np.float32)
    for busy, contrast, count in ((False, 1.0, 0), (True, 200.0, 0), (True, 1.0, 5)):
        found, _ = searched(image, np.full((5, 6), busy), (12.0,), 5, contrast=contrast, threshold=0.0)
        assert found == count


def test_places_of_the_search_are_fixed_to_the_sensor() -> None:
    """Search positions stay fixed on the sensor when a window moves."""
    image, busy, side = headers(1, 4), np.ones((6, 7), dtype=bool), 15.8
    for left, top in ((0, 0), (3, 2), (5, 7)):
        found, best = searched(
            image[top:, left:].copy(), busy, (side,), 1, contrast=3.0, threshold=0.35, corner=(left, top)
        )
        assert found == 1
        # the ring corner lies on the sensor grid
        corners = best[0, 1:3] + (left, top) - side / 2 - RING * side
        assert corners / (GRID * side) == pytest.approx(np.round(corners / (GRID * side)), abs=1e-6)
