"""Header search in solved pairs."""

import numpy as np
import pytest

from heliograph.receive.geometry.pose import ORIENTATIONS, Orientation
from heliograph.receive.screen.packets import find_headers, read_format
from heliograph.signal import haar
from heliograph.signal.header import header_levels, signalling_levels


@pytest.mark.parametrize("side", [8, 16])
@pytest.mark.parametrize("orientation", ORIENTATIONS, ids=str)
def test_headers_and_formats_are_found(side: int, orientation: Orientation) -> None:
    rng = np.random.default_rng(side)
    for identity, form in ((0, 0), (17, 0o2222), (29, 0o1765)):
        data = haar.encode(rng.choice([-1, 1], (7, side, side))).astype(float)
        data[3], data[4] = header_levels(identity, side), signalling_levels(identity, form, side)
        change = np.stack([orientation.turned(pair) for pair in data - 2]) + rng.normal(0, 0.3, data.shape)
        headers = find_headers(change, 2)
        found = [h for h in headers if (h.orientation, h.identity) == (orientation, identity)]
        assert found
        assert found[0].place == 3
        assert read_format(found[0], change, 2) == form


def test_data_are_not_taken_for_headers() -> None:
    data = haar.encode(np.random.default_rng(1).choice([-1, 1], (200, 8, 8))).astype(float) - 2
    assert find_headers(data, 2) == []
