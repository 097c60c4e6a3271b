"""Arrays located by given corners or region, end to end."""

from functools import cache

import numpy as np
import pytest
from scenes import link

from heliograph.base.errors import HeliographError, SettingsError
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import simulate
from heliograph.measure.bench import block_settings, random_messages
from heliograph.receive import receive_frames

DISTANCE_M = 40.0
TURNED = "[78,43,96,58,81,76,63,61]"
"""Corners, in whole pixels, for an array rotated by 40 degrees."""


def seen(**array: float) -> LinkSettings:
    place = {"x_m": 0.0, "y_m": 0.0, **array}
    return block_settings(link(distance_m=DISTANCE_M, arrays=[place]), 1)


@cache
def film(**array: float) -> list[Frame]:
    settings = seen(**array)
    return [frame for frame, _ in simulate(settings, random_messages(settings, 1), 1)]


def received(frames: list[Frame], *changes: str) -> list[str]:
    settings = link(*changes)
    return [packet.status for packet in receive_frames(frames, settings.signal, settings.receive)]


@pytest.mark.parametrize("receiver", ["plain", "soft"])
def test_a_turned_array_is_read_at_its_corners(receiver: str) -> None:
    frames, chosen = film(roll_deg=40.0), f"receive.receiver={receiver}"
    assert received(frames, chosen, f"receive.detect.corners={TURNED}") == ["ok"]


@pytest.mark.parametrize("receiver", ["plain", "soft"])
def test_an_array_upside_down_is_read_at_its_corners(receiver: str) -> None:
    """Corners do not identify the array's first corner; the header does."""
    frames = film(roll_deg=220.0 - 360.0)
    assert received(frames, f"receive.receiver={receiver}", f"receive.detect.corners={TURNED}") == ["ok"]


@pytest.mark.parametrize("receiver", ["plain", "soft"])
def test_a_faint_array_is_read_in_its_region(receiver: str) -> None:
    frames, chosen = film(brightness=0.03), f"receive.receiver={receiver}"
    assert received(frames, chosen) == []
    assert received(frames, chosen, "receive.detect.region=[60,40,40,40]") == ["ok"]
    assert received(frames, chosen, "receive.detect.region=[0,0,30,30]") == []


def test_an_array_that_half_of_the_frame_outshines_is_read_in_its_region() -> None:
    """Flicker over half the frame hides the array from the alternation threshold."""
    frames = [blinking(frame) for frame in film(brightness=0.2)]
    assert received(frames) == []
    assert received(frames, "receive.detect.region=[62,42,36,36]") == ["ok"]


def blinking(frame: Frame) -> Frame:
    """Add blinking stripes at the left and right border."""
    pixels = frame.pixels.copy()
    light = np.random.default_rng(frame.index).integers(0, 2, (120, 16)).repeat(3, axis=1) * 200
    pixels[:, :48], pixels[:, -48:] = light, light
    return Frame(frame.index, frame.time_s, pixels, frame.bits)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("corners=[1,2,3]", "receive.detect.corners"),
        ("corners=[10,10,90,90,90,10,10,90]", "four corners one after the other around an area"),
        ("corners=[10,10,10,10,10,10,10,10]", "four corners one after the other around an area"),
        ("corners=[10,10,90,10,30,30,10,90]", "four corners one after the other around an area"),
        ("region=[1,2,3]", "receive.detect.region"),
        ("region=[1,2,3,4]", "receive.detect.region"),
        ("region=[1.5,2,30,40]", "receive.detect.region"),
    ],
)
def test_what_is_no_place_is_refused_in_one_line(change: str, says: str) -> None:
    with pytest.raises(SettingsError) as caught:
        link(f"receive.detect.{change}")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("size", "key"), [(5, "min_side_px"), (600, "max_side_px")])
def test_corners_of_an_array_of_a_size_that_is_not_looked_for_are_refused(size: int, key: str) -> None:
    corners = f"receive.detect.corners=[0,0,{size},0,{size},{size},0,{size}]"
    with pytest.raises(SettingsError, match=rf"is {size} px a side.*: set receive\.detect\.{key}$"):
        received([], corners)


def test_a_region_beyond_the_film_is_said() -> None:
    with pytest.raises(HeliographError, match="beyond the frames, which are 160x120"):
        received(film(), "receive.detect.region=[200,0,30,30]")
