"""Near, rotated and mirrored arrays, end to end."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from recorder import Recorder
from scenes import link, received

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import simulate
from heliograph.measure.bench import block_settings, random_messages
from heliograph.receive import make_receiver
from heliograph.receive.events import DetectEvent
from heliograph.receive.geometry.pose import ORIENTATIONS, UPRIGHT, Orientation


def near(distance_m: float, receiver: str, *changes: str, identity: int = 0, size: int = 512) -> LinkSettings:
    changes = "signal.data_pairs=24", f"receive.receiver={receiver}", f"transmit.identities=[{identity}]", *changes
    return block_settings(link(*changes, distance_m=distance_m, camera={"width": size, "height": size}), 1)


def frames_of(settings: LinkSettings, margin_px: int | None = None) -> list[Frame]:
    return [frame for frame, _ in simulate(settings, random_messages(settings, 1), 1, None, margin_px)]


def read(settings: LinkSettings, frames: list[Frame]) -> list[tuple[int, str, Orientation]]:
    return [(p.identity, p.status, p.orientation) for p in received(frames, settings)]


@pytest.mark.parametrize(("receiver", "distance_m"), [("plain", 2.5), ("soft", 2.5)])
@pytest.mark.slow
def test_near_array_is_read(distance_m: float, receiver: str) -> None:
    settings = near(distance_m, receiver, "signal.data_pairs=16", identity=11)
    assert read(settings, frames_of(settings, 60)) == [(11, "ok", UPRIGHT)]


@pytest.mark.parametrize(("side", "pairs", "distance_m", "size"), [(8, 96, 4.0, 280), (32, 8, 4.0, 512)])
@pytest.mark.slow
def test_near_arrays_of_other_sizes_are_read(side: int, pairs: int, distance_m: float, size: int) -> None:
    settings = near(distance_m, "plain", f"signal.side={side}", f"signal.data_pairs={pairs}", size=size)
    assert read(settings, frames_of(settings)) == [(0, "ok", UPRIGHT)]


@pytest.mark.parametrize("receiver", ["plain", "soft"])
@pytest.mark.slow
def test_approach_changes_the_view_without_a_loss_of_packets(receiver: str) -> None:
    """The soft receiver waits for frames after a packet, while the header needed for redetection passes."""
    changes = "channel.speed_m_s=16.66", "channel.stop_m=1.5", "channel.duration_s=0.156"
    settings, recorder = near(9.8, receiver, *changes, size=192), Recorder()
    settings = block_settings(settings, 3)
    stream = make_receiver(settings.signal, settings.receive, recorder)
    packets = [packet for frame in frames_of(settings) for packet in stream.push(frame)]
    packets += stream.finish()
    assert [p.status for p in packets] == ["ok"] * 3
    assert recorder.lost_s or receiver == "plain"
    assert packets[-1].pose.pitch > 1.15 * packets[0].pose.pitch
    assert all(p.distance_m == pytest.approx(9.8 - 16.66 * (p.start_time_s + 0.026), rel=0.03) for p in packets)


@pytest.mark.slow
def test_enlarged_film_shows_no_other_array() -> None:
    settings = near(40.0, "plain", identity=7, size=112)
    enlarged = [
        replace(frame, pixels=cv2.resize(frame.pixels, None, fx=4, fy=4))  # type: ignore[arg-type]
        for frame in frames_of(settings)
    ]
    assert read(settings, enlarged) == [(7, "ok", UPRIGHT)]


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
    settings = near(5.534234459663689, "plain", identity=1)
    place = settings.channel.arrays[0]
    scale = settings.channel.distance_m / settings.channel.camera.focal_px
    place = replace(place, x_m=241.6 * scale, y_m=-163.62 * scale)
    camera = replace(settings.channel.camera, width=1024)
    settings = replace(settings, channel=replace(settings.channel, arrays=(place,), camera=camera))
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
