import numpy as np
from panel_films import keystone, to_unit

from heliograph.panel.place import UNIT, Place, Shape, area, corner_jacobian, grid, grow, homographies, transform

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
