"""Backgrounds: warp against a reference, mirrored clips, real footage."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from heliograph.channel.background import Clip, Footage, cover_size, draw_scene, draw_street, image_motion, warp
from heliograph.channel.camera import film
from heliograph.channel.scene import CameraPose, rotation
from heliograph.channel.settings import BackgroundSettings, ChannelSettings

SIZE = (96, 160)


def noise(seed: int, size: tuple[int, int] = SIZE) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, size).astype(np.uint8)


@pytest.mark.parametrize(
    ("turn", "shift"), [([[1, -4e-3], [4e-3, 1]], (18.2, 9.9)), ([[0.7, 0.01], [-0.01, 0.7]], (-5.0, 60.0))]
)
def test_warp_is_bilinear_interpolation(turn: list[list[float]], shift: tuple[float, float]) -> None:
    image, affine = noise(1), np.eye(3)
    affine[:2, :2], affine[:2, 2], affine[2, 2] = turn, shift, 0.9 / 255
    light = np.empty((64, 100), np.float32)
    warp(light, (3, 5), image.astype(np.float32), affine)
    rows, columns = np.indices(light.shape) + np.array([5, 3])[:, None, None]
    x = np.clip(affine[0, 0] * columns + affine[0, 1] * rows + affine[0, 2], 0, SIZE[1] - 1.001)
    y = np.clip(affine[1, 0] * columns + affine[1, 1] * rows + affine[1, 2], 0, SIZE[0] - 1.001)
    assert light == pytest.approx(0.9 / 255 * map_coordinates(image.astype(float), [y, x], order=1), abs=1e-5)


def test_background_moves_with_the_arrays() -> None:
    camera = ChannelSettings().camera  # a distant point moves by K R K^-1, to first order the background shift
    pitch, yaw, roll = 2e-3, -1e-3, 3e-3
    pose = CameraPose(*(np.array([v]) for v in (0.0, 0.0, pitch, yaw, roll, 0.0)))
    affine = image_motion(pose, (0,), camera, (camera.height, camera.width), np.inf)
    lens = np.array([[camera.focal_px, 0, 511.5], [0, camera.focal_px, 255.5], [0, 0, 1]])
    turn = lens @ rotation(pitch, yaw, roll) @ np.linalg.inv(lens)
    for point in ([511.5, 255.5], [300.0, 100.0], [800.0, 400.0]):
        exact = turn @ np.array([*point, 1])
        assert affine[:2] @ np.array([*point, 1]) == pytest.approx(exact[:2] / exact[2], abs=0.15)


def test_clip_runs_forward_and_backward_and_is_read_only_as_far_as_needed() -> None:
    images = [np.full((4, 8), k, np.uint8) for k in range(4)]
    clip = Clip(Footage(lambda: iter(images), 10.0), (4, 8))
    shown = [round(float(clip.at(t / 10 + 0.01)[0, 0])) for t in range(12)]
    assert (shown, clip.at(0.125)[0, 0]) == ([0, 1, 2, 3, 2, 1, 0, 1, 2, 3, 2, 1], pytest.approx(1.25))
    assert clip.at(0.425)[0, 0] == pytest.approx(1.75)
    frames = iter([noise(k) for k in range(100)])
    Clip(Footage(lambda: frames, 10.0), SIZE).at(0.35)
    assert len(list(frames)) == 95
    assert np.array_equal(Clip(Footage(lambda: iter([noise(0)]), 10.0), SIZE).at(3.14), noise(0))


@pytest.mark.parametrize(("shape", "rate_hz", "message"), [
    ((0, 4, 4), 10.0, "no frames"), ((1, 4, 4, 3), 10.0, "gray uint8"), ((1, 4, 4), 0.0, "rate above 0, not 0"),
])  # fmt: skip
def test_broken_footage_is_refused(shape: tuple[int, ...], rate_hz: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Clip(Footage(lambda: iter(np.zeros(shape, np.uint8)), rate_hz), SIZE).at(0)


def test_footage_covers_the_frame_without_distortion() -> None:
    frame = np.zeros((90, 160), np.uint8)
    frame[35:55, 70:90] = 255  # a square stays square
    scaled = cover_size(frame, (640, 1152)) > 128
    assert (scaled.shape, scaled.any(0).sum()) == ((640, 1152), pytest.approx(scaled.any(1).sum(), abs=2))


def test_drawn_scene_has_dark_and_bright_and_follows_the_seed() -> None:
    a, b, c = (draw_scene((320, 576), np.random.default_rng(s)) for s in (1, 1, 2))
    assert np.array_equal(a, b)
    assert not np.array_equal(a, c)
    assert a.max() > 180
    assert 20 < a.mean() < 120


@pytest.mark.parametrize("size", [(20, 30), (300, 200)])
def test_a_street_has_any_size_and_is_the_same_for_a_seed(size: tuple[int, int]) -> None:
    day, night = (draw_street(size, np.random.default_rng(2), dark) for dark in (False, True))
    assert day.shape == night.shape == size
    assert day.dtype == np.uint8
    assert night.mean() < 0.4 * day.mean()
    middle = slice(size[1] // 2 - 2, size[1] // 2 + 2)  # by day the sky is brighter than the road
    assert day[size[0] // 4, middle].mean() > day[-1, size[1] // 3]
    assert np.array_equal(day, draw_street(size, np.random.default_rng(2)))
    assert not np.array_equal(day, draw_street(size, np.random.default_rng(3)))


@pytest.mark.real_data
@pytest.mark.slow
def test_real_footage_becomes_a_film(data: Path) -> None:
    import av

    def frames() -> Iterator[NDArray[np.uint8]]:
        with av.open(str(data / "driving" / "day-shade.mp4")) as container:
            for frame in container.decode(video=0):
                yield np.asarray(frame.to_ndarray(format="gray"), np.uint8)

    settings = ChannelSettings(duration_s=0.005, background=BackgroundSettings(kind="footage"))
    lights = [iter([np.full((16, 16), 2, np.uint8)] * 60)]
    made = list(film(settings, lights, np.random.default_rng(0), pattern_period_s=1e-3, footage=Footage(frames, 25)))
    assert len(made) == 5
    assert made[0][0].pixels.mean() == pytest.approx(next(frames()).mean(), rel=0.15)
    assert made[0][0].pixels.std() > 20
