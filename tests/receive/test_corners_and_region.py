"""Arrays located by given corners or region, end to end."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scenes import link, received, statuses

from heliograph.base.errors import HeliographError, SettingsError
from heliograph.base.frames import Frame
from heliograph.link.simulate import simulate
from heliograph.measure.bench import block_settings, random_messages

TURNED = "[78,43,96,58,81,76,63,61]"
"""Corners, in whole pixels, for an array rotated by 40 degrees."""


@cache
def film(**array: float) -> list[Frame]:
    settings = link("signal.data_pairs=8", distance_m=40.0, arrays=[{"x_m": 0.0, "y_m": 0.0, **array}])
    settings = block_settings(settings, 1)
    return [frame for frame, _ in simulate(settings, random_messages(settings, 1), 1)]


def read(frames: list[Frame], *changes: str) -> list[str]:
    return statuses(received(frames, link("signal.data_pairs=8", *changes)))


@pytest.mark.parametrize(("receiver", "roll_deg"), [("plain", 40.0), ("soft", -140.0)])
@pytest.mark.slow
def test_turned_array_is_read_at_its_corners(roll_deg: float, receiver: str) -> None:
    """Corners do not identify the array's first corner; the header does."""
    assert read(film(roll_deg=roll_deg), f"receive.receiver={receiver}", f"receive.detect.corners={TURNED}") == ["ok"]


@pytest.mark.parametrize("receiver", ["plain", "soft"])
@pytest.mark.slow
def test_faint_array_is_read_in_its_region(receiver: str) -> None:
    frames, chosen = film(brightness=0.03), f"receive.receiver={receiver}"
    assert read(frames, chosen, "receive.detect.region=[60,40,40,40]") == ["ok"]
    assert read(frames, chosen) == []
    assert read(frames, chosen, "receive.detect.region=[0,0,30,30]") == []


def test_array_outshone_by_half_of_the_frame_is_read_in_its_region() -> None:
    """Flicker over half the frame hides the array from the alternation threshold."""
    frames = list[Frame]()
    for frame in film(brightness=0.2):
        pixels = frame.pixels.copy()
        # blinking stripes at the left and right border
        light = np.random.default_rng(frame.index).integers(0, 2, (120, 16)).repeat(3, axis=1) * 200
        pixels[:, :48], pixels[:, -48:] = light, light
        frames.append(replace(frame, pixels=pixels))
    assert read(frames) == []
    assert read(frames, "receive.detect.region=[62,42,36,36]") == ["ok"]


@pytest.mark.parametrize(("change", "says"), [
    ("corners=[1,2,3]", "receive.detect.corners"),
    ("corners=[10,10,90,90,90,10,10,90]", "four corners one after the other around an area"),
    ("corners=[10,10,10,10,10,10,10,10]", "four corners one after the other around an area"),
    ("corners=[10,10,90,10,30,30,10,90]", "four corners one after the other around an area"),
    ("region=[1,2,3]", "receive.detect.region"), ("region=[1,2,3,4]", "receive.detect.region"),
    ("region=[1.5,2,30,40]", "receive.detect.region"),
])  # fmt: skip
def test_invalid_corners_or_region_are_refused_in_one_line(change: str, says: str) -> None:
    with pytest.raises(SettingsError) as caught:
        link(f"receive.detect.{change}")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("size", "key"), [(5, "min_side_px"), (600, "max_side_px")])
def test_corners_outside_the_searched_sizes_are_refused(size: int, key: str) -> None:
    corners = f"receive.detect.corners=[0,0,{size},0,{size},{size},0,{size}]"
    with pytest.raises(SettingsError, match=rf"is {size} px a side.*: set receive\.detect\.{key}$"):
        read([], corners)


def test_region_beyond_the_frames_is_refused() -> None:
    with pytest.raises(HeliographError, match="beyond the frames, which are 160x120"):
        read(film(), "receive.detect.region=[200,0,30,30]")
