"""Near, rotated and mirrored arrays, and sizes other than 16 x 16, end to end."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from recorder import Recorder
from scenes import codewords, film, link, received

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import simulate
from heliograph.measure.bench import block_settings, random_messages
from heliograph.receive.events import DetectEvent
from heliograph.receive.geometry.pose import ORIENTATIONS, UPRIGHT, Orientation


def near(distance_m: float, receiver: str, *changes: str, identity: int = 0, size: int = 512) -> LinkSettings:
    changes = "signal.data_pairs=24", f"receive.receiver={receiver}", f"transmit.identities=[{identity}]", *changes
    return block_settings(link(*changes, distance_m=distance_m, camera={"width": size, "height": size}), 1)


def frames_of(settings: LinkSettings, margin_px: int | None = None) -> list[Frame]:
    return [frame for frame, _ in simulate(settings, random_messages(settings, 1), 1, None, margin_px)]


def read(settings: LinkSettings, frames: list[Frame]) -> list[tuple[int, str, Orientation]]:
    return [(p.identity, p.status, p.orientation) for p in received(frames, settings)]


@pytest.mark.parametrize(("receiver", "side", "pairs", "distance_m", "size", "margin_px"), [
    ("plain", 16, 16, 2.5, 512, 60), ("soft", 16, 16, 2.5, 512, 60),
    ("plain", 8, 96, 4.0, 280, None), ("plain", 32, 8, 4.0, 512, None),
])  # fmt: skip
@pytest.mark.slow
def test_near_array_is_read(
    receiver: str, side: int, pairs: int, distance_m: float, size: int, margin_px: int | None
) -> None:
    changes = f"signal.side={side}", f"signal.data_pairs={pairs}"
    settings = near(distance_m, receiver, *changes, identity=11, size=size)
    assert read(settings, frames_of(settings, margin_px)) == [(11, "ok", UPRIGHT)]


@pytest.mark.parametrize("receiver", ["plain", "soft"])
@pytest.mark.slow
def test_approach_changes_the_view_without_a_loss_of_packets(receiver: str) -> None:
    """The soft receiver waits for frames after a packet, while the header needed for redetection passes."""
    changes = "channel.speed_m_s=16.66", "channel.stop_m=1.5", "channel.duration_s=0.156"
    settings, recorder = block_settings(near(9.8, receiver, *changes, size=192), 3), Recorder()
    packets = received(frames_of(settings), settings, recorder)
    assert [p.status for p in packets] == ["ok"] * 3
    assert recorder.lost_s or receiver == "plain"
    assert packets[-1].pose.pitch > 1.15 * packets[0].pose.pitch
    assert all(p.distance_m == pytest.approx(9.8 - 16.66 * (p.start_time_s + 0.026), rel=0.03) for p in packets)


@pytest.mark.slow
def test_enlarged_film_shows_no_other_array() -> None:
    settings = near(40.0, "plain", identity=7, size=112)
    frames = [Frame(f.index, f.time_s, cv2.resize(f.pixels, None, fx=4, fy=4)) for f in frames_of(settings)]  # type: ignore[arg-type]
    assert read(settings, frames) == [(7, "ok", UPRIGHT)]


@pytest.mark.parametrize(
    ("receiver", "orientation"),
    [*(("plain", orientation) for orientation in ORIENTATIONS), ("soft", ORIENTATIONS[2]), ("soft", ORIENTATIONS[5])],
    ids=str,
)
def test_turned_and_mirrored_arrays_are_read(receiver: str, orientation: Orientation) -> None:
    settings = near(35.0, receiver, "channel.camera.width=96", identity=9, size=80)
    turned = [replace(frame, pixels=orientation.turned(frame.pixels)) for frame in frames_of(settings)]
    assert read(settings, turned) == [(9, "ok", orientation)]


@pytest.mark.slow
def test_shifted_turned_header_is_fitted() -> None:
    distance_m = 5.534234459663689
    x_m, y_m = (px * distance_m * 12e-6 / 0.035 for px in (241.6, -163.62))
    place = f"channel.arrays=[{{x_m={x_m}, y_m={y_m}}}]"
    settings = near(distance_m, "plain", place, "channel.camera.width=1024", identity=1)
    turned = [replace(frame, pixels=np.rot90(frame.pixels, -1)) for frame in frames_of(settings)]
    assert read(settings, turned) == [(1, "ok", ORIENTATIONS[1])]


@pytest.mark.parametrize("receiver", ["plain", "soft"])
def test_array_that_fills_the_frame_is_found(receiver: str) -> None:
    """Border replication once extended LEDs at the frame edge and reduced the correlation by 10 %."""
    settings, recorder = near(1.88, receiver, identity=15), Recorder()
    settings = replace(settings, channel=replace(settings.channel, duration_s=0.014))
    assert not received(frames_of(settings), settings, recorder)
    (found,) = [event.detection for event in recorder.of(DetectEvent)]
    assert (found.identity, found.orientation) == (15, UPRIGHT)
    assert found.score > 0.99


@pytest.mark.parametrize(
    ("receiver", "roll_deg"), [("plain", -45.0), ("plain", 30.0), ("plain", 109.8), ("soft", -45.0), ("soft", 60.0)]
)
@pytest.mark.slow
def test_array_of_any_roll_is_read(roll_deg: float, receiver: str) -> None:
    """Includes angles midway between two orientations; decoding starts with the second header at the latest."""
    settings = block_settings(near(30.0, receiver, f"channel.arrays.0.roll_deg={roll_deg}", size=96), 3)
    assert [(identity, status) for identity, status, _ in read(settings, frames_of(settings))][-2:] == [(0, "ok")] * 2


DATA_PAIRS = {4: 100, 8: 48, 32: 8}  # for at least one codeword per layer


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
