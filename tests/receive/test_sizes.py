"""Array sizes other than 16 x 16, end to end."""

from typing import Any

import pytest
from scenes import codewords, film, link, received

from heliograph.link.settings import LinkSettings

DATA_PAIRS = {4: 100, 8: 48, 32: 8}
"""Data pairs for at least one codeword per layer."""


def sized(side: int, receiver: str, distance_m: float, *changes: str, **channel: Any) -> LinkSettings:
    pairs, camera = f"signal.data_pairs={DATA_PAIRS[side]}", {"width": 160, "height": 160}
    changes = f"signal.side={side}", pairs, f"receive.receiver={receiver}", *changes
    return link(*changes, distance_m=distance_m, **{"camera": camera, **channel})


@pytest.mark.parametrize(("side", "receiver", "distance_m"), [
    (4, "plain", 15.0), (4, "soft", 20.0), (8, "plain", 45.0), (8, "soft", 85.0), (32, "plain", 50.0),
    (32, "soft", 95.0),
])  # fmt: skip
@pytest.mark.slow
def test_all_codewords_are_read(side: int, receiver: str, distance_m: float) -> None:
    packets = 2 if side < 32 else 1
    settings = sized(side, receiver, distance_m)
    assert codewords(settings, max_packets=packets) == [(packets, 0), (2 * packets, 0), (packets, 0)]


def camera_at(fps: float, start_s: float) -> dict[str, Any]:
    camera = {"width": 160, "height": 160, "fps": fps, "exposure_s": 1 / fps}
    return {"camera": camera, "arrays": [{"x_m": 0.0, "y_m": 0.0, "start_s": start_s}]}


@pytest.mark.parametrize(("side", "distance_m", "changes", "channel"), [
    (8, 50.0, [], camera_at(1000.0, 4e-4)), (32, 60.0, [], camera_at(1500.0, 2e-4)),
    (32, 60.0, ["transmit.formats=[{mode='single'}]"], {}),
    (8, 50.0, [], {"arrays": [{"x_m": 0.0, "y_m": 0.0, "hidden": (0.0, 0.0, 0.5, 0.5)}]}),
], ids=["half a pattern late", "1500 frames/s", "without inverses", "a quarter hidden"])  # fmt: skip
@pytest.mark.slow
def test_impaired_array_is_read(side: int, distance_m: float, changes: list[str], channel: dict[str, Any]) -> None:
    settings = sized(side, "soft", distance_m, *changes, **channel)
    assert codewords(settings, max_packets=1) == [(1, 0), (2, 0), (1, 0)]


@pytest.mark.parametrize("receiver", ["plain", "soft"])
@pytest.mark.parametrize("side", [8, 32])
def test_distance_and_position_are_measured(side: int, receiver: str) -> None:
    settings = sized(side, receiver, 40.0)
    frames = film(settings, settings.signal.packet_patterns + 1, roi_margin_px=20)
    (packet,) = received(frames, settings)
    assert (packet.status, packet.pairs_seen) == ("ok", 1)
    assert packet.distance_m == pytest.approx(40.0, rel=0.01)
    assert (packet.pose.x, packet.pose.y) == pytest.approx((79.5, 79.5), abs=0.05)
