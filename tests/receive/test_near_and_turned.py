"""Near, rotated and mirrored arrays, end to end."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from recorder import Recorder
from scenes import link

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import simulate
from heliograph.measure.bench import block_settings, random_messages
from heliograph.receive import make_receiver, receive_frames
from heliograph.receive.events import DetectEvent
from heliograph.receive.geometry.pose import ORIENTATIONS, UPRIGHT, Orientation


def near(distance_m: float, receiver: str, *changes: str, identity: int = 0) -> LinkSettings:
    camera = {"width": 512, "height": 512}
    settings = link(f"receive.receiver={receiver}", *changes, distance_m=distance_m, camera=camera)
    settings = replace(settings, transmit=replace(settings.transmit, identities=(identity,)))
    return block_settings(settings, 1)


def frames_of(settings: LinkSettings, seed: int = 1) -> list[Frame]:
    return [frame for frame, _ in simulate(settings, random_messages(settings, seed), seed)]


def received(settings: LinkSettings, frames: list[Frame]) -> list[tuple[int, str, Orientation]]:
    packets = receive_frames(frames, settings.signal, settings.receive)
    return [(p.identity, p.status, p.orientation) for p in packets]


@pytest.mark.parametrize("receiver", ["plain", "soft"])
@pytest.mark.parametrize("distance_m", [2.5, 6.0])
@pytest.mark.slow
def test_a_near_array_is_read(distance_m: float, receiver: str) -> None:
    settings = near(distance_m, receiver, identity=11)
    assert received(settings, frames_of(settings)) == [(11, "ok", UPRIGHT)]


@pytest.mark.parametrize("side", [8, 32])
@pytest.mark.slow
def test_near_arrays_of_other_sizes_are_read(side: int) -> None:
    pairs = {8: 96, 32: 8}[side]
    settings = near(4.0 if side == 32 else 2.0, "plain", f"signal.side={side}", f"signal.data_pairs={pairs}")
    assert received(settings, frames_of(settings)) == [(0, "ok", UPRIGHT)]


@pytest.mark.parametrize(("receiver", "from_m"), [("plain", 7.0), ("soft", 9.8), ("soft", 4.9)])
@pytest.mark.slow
def test_an_approach_changes_the_level_without_a_loss(receiver: str, from_m: float) -> None:
    """The soft receiver waits for frames after a packet, while the header needed for redetection passes."""
    settings = near(from_m, receiver, "channel.speed_m_s=8.33", "channel.stop_m=1.5", "channel.duration_s=0.3")
    settings, recorder = block_settings(settings, 3), Recorder()
    receiver_of_it = make_receiver(settings.signal, settings.receive, recorder)
    packets = [packet for frame in frames_of(settings) for packet in receiver_of_it.push(frame)]
    packets += receiver_of_it.finish()
    assert [p.status for p in packets] == ["ok"] * 3
    assert recorder.lost_s or receiver == "plain"
    assert packets[-1].pose.pitch > 1.15 * packets[0].pose.pitch
    assert all(p.distance_m == pytest.approx(from_m - 8.33 * (p.start_time_s + 0.05), rel=0.03) for p in packets)


@pytest.mark.slow
def test_an_enlarged_film_shows_no_other_array() -> None:
    settings = near(40.0, "plain", identity=7)
    enlarged = [
        replace(frame, pixels=cv2.resize(frame.pixels[200:312, 200:312], None, fx=4, fy=4))  # type: ignore[arg-type]
        for frame in frames_of(settings)
    ]
    assert received(settings, enlarged) == [(7, "ok", UPRIGHT)]


@pytest.mark.parametrize(
    ("receiver", "orientation"),
    [*(("plain", one) for one in ORIENTATIONS), ("soft", ORIENTATIONS[2]), ("soft", ORIENTATIONS[5])],
    ids=str,
)
@pytest.mark.slow
def test_turned_and_mirrored_arrays_are_read(receiver: str, orientation: Orientation) -> None:
    settings = near(35.0, receiver, "channel.camera.width=96", "channel.camera.height=80", identity=9)
    turned = [replace(frame, pixels=orientation.turned(frame.pixels)) for frame in frames_of(settings)]
    assert received(settings, turned) == [(9, "ok", orientation)]


@pytest.mark.slow
def test_what_a_turned_header_shifted_looks_like_is_fitted_too() -> None:
    settings = near(5.534234459663689, "plain", "channel.duration_s=0.1", identity=1)
    place = settings.channel.arrays[0]
    scale = settings.channel.distance_m / settings.channel.camera.focal_px
    place = replace(place, x_m=241.6 * scale, y_m=-163.62 * scale)
    camera = replace(settings.channel.camera, width=1024)
    settings = replace(settings, channel=replace(settings.channel, arrays=(place,), camera=camera))
    turned = [replace(frame, pixels=np.rot90(frame.pixels, -1)) for frame in frames_of(settings)]
    assert received(settings, turned) == [(1, "ok", ORIENTATIONS[1])]


@pytest.mark.parametrize("receiver", ["plain", "soft"])
def test_an_array_that_fills_the_frame_is_found(receiver: str) -> None:
    """Border replication once extended LEDs at the frame edge and reduced the correlation by 10 %."""
    settings, recorder = near(1.88, receiver, "signal.data_pairs=16", identity=15), Recorder()
    packets = receive_frames(frames_of(settings)[:14], settings.signal, settings.receive, recorder)
    assert not list(packets)
    (found,) = [event.detection for event in recorder.of(DetectEvent)]
    assert (found.identity, found.orientation) == (15, UPRIGHT)
    assert found.score > 0.99


ROLLS_DEG = np.random.default_rng(5).uniform(-180, 180, 4).round(1).tolist()


@pytest.mark.parametrize("receiver", ["plain", "soft"])
@pytest.mark.parametrize("roll_deg", [-45.0, 30.0, 60.0, *ROLLS_DEG])
def test_an_array_of_any_roll_is_read(roll_deg: float, receiver: str) -> None:
    """Includes angles midway between two orientations; decoding starts with the second header at the latest."""
    camera = {"width": 96, "height": 96}
    settings = link(
        f"receive.receiver={receiver}", f"channel.arrays.0.roll_deg={roll_deg}", distance_m=30, camera=camera
    )
    settings = block_settings(settings, 3)
    assert [(one, status) for one, status, _ in received(settings, frames_of(settings))][-2:] == [(0, "ok")] * 2
