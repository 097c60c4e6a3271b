from pathlib import Path

import cv2
import numpy as np
import pytest

import heliograph

COLOURS = np.random.default_rng(0).integers(0, 256, (3, 6, 8, 3), dtype=np.uint8)
"""Three RGB frames, (rows, columns, 3)."""


def test_pictures_are_read_in_their_colours(tmp_path: Path) -> None:
    for number, colours in enumerate(COLOURS):
        cv2.imwrite(str(tmp_path / f"img{number}.png"), colours[..., ::-1])
    with heliograph.open_colours(tmp_path, rate_hz=50) as film:
        assert (film.width, film.height, film.bits, film.rate_hz, film.frame_count) == (8, 6, 8, 50, 3)
        np.testing.assert_array_equal(list(film), COLOURS)
        np.testing.assert_array_equal(next(iter(film)), COLOURS[0])
    with pytest.raises(heliograph.MediaError, match="closed"):
        list(film)
    with heliograph.open_colours(tmp_path, rate_hz=50, crop=(2, 1, 4, 3), rotate=90) as film:
        np.testing.assert_array_equal(next(iter(film)), np.rot90(COLOURS[0, 1:4, 2:6], -1))


def test_a_gray_film_has_three_equal_colours(tmp_path: Path) -> None:
    np.save(tmp_path / "gray.npy", COLOURS[..., 0].astype(np.uint16))
    with heliograph.open_colours(tmp_path / "gray.npy", rate_hz=50) as film:
        for seen, known in zip(film, COLOURS[..., 0], strict=True):
            np.testing.assert_array_equal(seen, np.dstack([known] * 3))


def test_a_channel_is_refused(tmp_path: Path) -> None:
    with pytest.raises(heliograph.MediaError, match="has all channels: leave channel out"):
        heliograph.open_colours(tmp_path, channel="red")
    with pytest.raises(heliograph.MediaError, match="there is no file"):
        heliograph.open_colours(tmp_path / "none.mkv")
