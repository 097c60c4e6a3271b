"""Tracking: arrays at rest and in hard shake, and the contrast by which an array is known to be in sight."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from recorder import Recorder
from scenes import drawn_film, link
from scipy.ndimage import gaussian_filter1d

from heliograph.receive import Pose, receive_frames
from heliograph.receive.track.tracker import TrackedPair, contrast

Floats = NDArray[np.float64]


def at_rest(t: Floats) -> Floats:
    return np.stack([47.3 + 0 * t, 48.8 + 0 * t], -1)


def shaking(t: Floats) -> Floats:
    """At most 0.9 px/ms, 40 Hz."""
    reach = 900 / (2 * np.pi * 40)
    return np.stack([47.3 + reach * np.sin(2 * np.pi * 40 * t), 48.8 + 0.5 * reach * np.cos(2 * np.pi * 40 * t)], -1)


def errors(tracked: list[TrackedPair], path: Callable[[Floats], Floats]) -> Floats:
    """Error of the position in px at each pair, (pairs, 2); a time is the start of an exposure of 1 ms."""
    times = np.array([t.state.time_s for t in tracked])
    places = np.array([(t.state.pose.x, t.state.pose.y) for t in tracked])
    return np.asarray(places - path(times + 0.5e-3), np.float64)


@pytest.mark.parametrize("distance_m", [25.0, 40.0, 80.0])
def test_hard_shake_is_followed(distance_m: float) -> None:
    settings, recorder = link(), Recorder()
    frames = drawn_film(settings, 200, shaking, distance_m=distance_m)
    packets = list(receive_frames(frames, settings.signal, settings.receive, recorder))
    assert [all(word.status == "ok" for word in p.layers["high"]) for p in packets] == [True, True]
    assert recorder.lost_s == []
    assert all(t.seen for t in recorder.tracked)
    assert np.sqrt(np.mean(errors(recorder.tracked, shaking)[3:] ** 2)) < 0.1


@pytest.mark.parametrize("distance_m", [40.0, 80.0])
def test_at_rest_the_position_is_sharp(distance_m: float) -> None:
    settings, recorder = link("signal.data_pairs=16"), Recorder()
    frames = drawn_film(settings, 72, at_rest, distance_m=distance_m)
    list(receive_frames(frames, settings.signal, settings.receive, recorder))
    assert np.sqrt(np.mean(errors(recorder.tracked, at_rest)[3:] ** 2)) < 0.02


@pytest.mark.parametrize(("pitch", "blur"), [(0.3, 0.5), (0.7, 0.5), (4.0, 0.2)])
def test_contrast_is_what_blur_leaves_of_a_square_of_leds(pitch: float, blur: float) -> None:
    x = np.linspace(-20, 20, 40001)
    sharp = (np.abs(x) < pitch).astype(float)
    sigma = np.hypot(blur, 12**-0.5)
    blurred = gaussian_filter1d(sharp, sigma / (x[1] - x[0]), mode="constant")
    # along x and along y
    left = ((blurred**2).sum() / (sharp**2).sum()) ** 2
    assert contrast(Pose(0, 0, pitch, 0, blur)) == pytest.approx(np.sqrt(left), rel=1e-2)
