import numpy as np
import panel_oracle as reference
import pytest
from panel_films import keystone, to_unit

from heliograph.panel import kernels
from heliograph.panel.place import UNIT, Place, Shape, area, corner_jacobian, grid, grow, homographies, transform

POINTS = np.array([[10.3, 8.7], [0.2, 14.9], [19.4, 0.1], [-1.5, 5.0], [40.0, 5.0], [np.nan, 2.0]])
"""Positions inside, on the rim, just outside, far outside, and NaN."""
SIZE = (16, 20)


@pytest.mark.parametrize("sigma", [0.7, 1.8])
def test_inner_products_and_drawings_are_those_of_the_reference(sigma: float) -> None:
    image = np.random.default_rng(0).normal(10, 3, SIZE).astype(np.float32)
    out = np.full((len(POINTS), 4), np.nan)
    kernels.project(image, POINTS, sigma, 4 * sigma, out)
    known = reference.gathered(image.astype(np.float64), POINTS[:-1], sigma, 4 * sigma)
    np.testing.assert_allclose(out[:-1], known, rtol=2e-4, atol=2e-4)
    assert (out[4:] == 0).all()
    amounts, drawn = np.random.default_rng(1).normal(0, 50, (len(POINTS), 4)), np.ones(SIZE, np.float32)
    kernels.render(amounts, POINTS, sigma, 4 * sigma, drawn)
    known = reference.drawn(amounts[:-1], POINTS[:-1], sigma, 4 * sigma, SIZE)
    np.testing.assert_allclose(drawn - 1, known, atol=2e-4)


def test_derivatives_of_the_reference_are_differences() -> None:
    point, sigma, step = np.array([7.4, 8.1]), 1.6, 1e-4
    found = reference.shapes(point, sigma, 100.0, SIZE)

    def shape(x: float = 0.0, y: float = 0.0, grow: float = 0.0) -> np.ndarray:
        return np.asarray(reference.shapes(point + np.array([x, y]), sigma * np.exp(grow), 100.0, SIZE)[0])

    for k, name in ((1, "x"), (2, "y"), (3, "grow")):
        slope = (shape(**{name: step}) - shape(**{name: -step})) / (2 * step)
        np.testing.assert_allclose(found[k], slope, atol=1e-7)


CORNERS = keystone((70.0, 60.0), 80.0, 1.3, 0.2, 0.25)


def test_a_homography_maps_the_unit_square_to_the_corners() -> None:
    map_ = homographies(CORNERS)
    np.testing.assert_allclose(transform(map_, UNIT), CORNERS, atol=1e-10)
    known = np.linalg.inv(to_unit(CORNERS))
    np.testing.assert_allclose(map_, known / known[2, 2], atol=1e-8)


def test_leds_lie_half_a_pitch_within_the_corners() -> None:
    square = Place(np.array([[9.5, 19.5], [49.5, 19.5], [49.5, 39.5], [9.5, 39.5]]))
    leds = square.leds(2, 4)
    np.testing.assert_allclose(leds[0, 0], [14.5, 24.5])
    np.testing.assert_allclose(leds[1, 3], [44.5, 34.5])
    assert Shape(2, 4).pitches(square.corners) == (10.0, 10.0)


def test_slopes_are_differences_of_mapped_points() -> None:
    points, moved = grid(3, 4), CORNERS.copy()
    moved[2, 1] += 0.02
    change = (transform(homographies(moved), points) - transform(homographies(CORNERS), points)) / 0.02
    np.testing.assert_allclose(corner_jacobian(CORNERS, points)[5], change, atol=1e-3)


def test_a_grown_quadrilateral_has_its_sides_farther_out() -> None:
    for corners in (CORNERS, CORNERS[::-1]):
        outer = grow(corners, 3.0)
        for k in range(4):
            side = corners[(k + 1) % 4] - corners[k]
            normal = np.array([side[1], -side[0]]) / np.linalg.norm(side)
            assert abs(abs(normal @ (outer[k] - corners[k])) - 3.0) < 1e-9
        assert abs(area(outer)) > abs(area(corners))
