"""Screen films: phone rates, rotation, wrong nominal rates and tracking loss."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import heliograph
from heliograph.base.arrays import Floats
from heliograph.base.errors import SettingsError
from heliograph.base.frames import Frame, Pixels
from heliograph.link.film import write_film
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.receive import Packet
from heliograph.receive.events import DecodeEvent, DetectEvent, ExtractEvent, LostEvent, TrackEvent
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import AnyFrame
from heliograph.signal.block import Block
from heliograph.signal.fountain.files import FileGatherer, SentFile, WholeFile
from heliograph.signal.settings import SignalSettings

SMALL = (
    "channel.camera.width=480",
    "channel.camera.height=270",
    "channel.camera.pixel_m=1.1e-5",
    "channel.distance_m=0.75",
    "receive.calibration.pixel_m=1.1e-5",
)
"""A 155 px array in a small frame, for speed; the readout time for all rows is unchanged."""


def link(preset: str, packets: float, *changes: str) -> LinkSettings:
    base = load_settings(preset)
    readout = base.channel.camera.row_time_s * base.channel.camera.height
    rows = f"channel.camera.row_time_s={readout / 270}"
    return load_settings(preset, None, [*SMALL, rows, f"channel.duration_s={packets * base.signal.packet_s}", *changes])


def frames(settings: LinkSettings, seed: int = 3) -> list[Frame]:
    return [frame for frame, _ in simulate(settings, default_messages(settings), seed)]


def read(settings: LinkSettings, film: list[Frame], signal: SignalSettings | None = None) -> list[Packet]:
    return list(heliograph.receive_frames(film, signal or settings.signal, settings.receive))


@pytest.mark.parametrize("preset", ["phone", "phone-15", "phone-60", "phone-240"])
@pytest.mark.slow
def test_phones_read_at_their_rates(preset: str) -> None:
    settings = link(preset, 2.2 if preset == "phone-240" else 1.2)
    packets = read(settings, frames(settings))
    assert packets
    assert packets[0].status == "ok"
    assert packets[0].format.mode == "short"
    assert packets[0].distance_m == pytest.approx(0.75, rel=0.1)


@pytest.mark.parametrize(
    ("turn", "said"), [(lambda p: p.T[::-1], "turned 270"), (lambda p: p[::-1, ::-1], "turned 180")]
)
@pytest.mark.slow
def test_a_turned_phone_reads_columns_as_rows(turn: Callable[[Pixels], Pixels], said: str) -> None:
    settings = link("phone-60", 1.2)
    turned = [replace(one, pixels=turn(one.pixels).copy()) for one in frames(settings)]
    packets = read(settings, turned)
    assert [packet.status for packet in packets] == ["ok"]
    assert str(packets[0].orientation) == said


@pytest.mark.slow
def test_the_rate_and_the_length_are_found() -> None:
    settings = link("phone-60", 1.3, "signal.side=8", "channel.emitter.pitch_m=0.04")
    other = replace(settings.signal, pattern_period_s=0.1, data_pairs=48)
    packets = read(settings, frames(settings), other)
    assert [packet.status for packet in packets] == ["ok"]


@pytest.mark.slow
def test_a_file_of_8_by_8_cells_comes_by_packets_of_30_patterns() -> None:
    file = SentFile("a.txt", bytes(range(70)))
    form = "transmit.formats.0.high=3/4", "transmit.formats.0.middle=3/4", "transmit.formats.0.low=3/4"
    settings = link("phone-60", 4.3, "signal.side=8", "channel.emitter.pitch_m=0.04", *form)
    content = {layer: [file] for layer in ("high", "middle", "low")}
    film = [frame for frame, _ in simulate(settings, [content], 3)]
    files, whole = FileGatherer(), list[WholeFile]()
    for packet in read(settings, film):
        for word in (word for words in packet.layers.values() for word in words):
            if word.block is not None and not isinstance(word.block, Block):
                progress = files.add(word.block)
                whole += [progress.whole] if progress is not None and progress.whole is not None else []
    assert [(one.name, one.data) for one in whole] == [(file.name, file.data)]


@pytest.mark.slow
def test_a_film_as_phones_write_it(tmp_path: Path) -> None:
    settings = link("phone-60", 1.2, "channel.emitter.backlight_hz=240", "channel.emitter.backlight_duty=0.6")
    events: list[object] = []
    write_film(tmp_path / "phone.mp4", settings, default_messages(settings), 3, mbit_s=4)
    with heliograph.open_film(tmp_path / "phone.mp4") as film:
        packets = list(heliograph.receive_frames(film, settings.signal, settings.receive, events.append))
    assert [packet.status for packet in packets] == ["ok"]
    assert [type(event) for event in events if not isinstance(event, TrackEvent | ExtractEvent)] == [
        DetectEvent,
        DecodeEvent,
        LostEvent,
    ]
    boxes = [event for event in events if isinstance(event, TrackEvent)]
    assert len(boxes) > 30
    assert all(one.tracked.state.pose.pitch == pytest.approx(155 / 16, rel=0.1) for one in boxes)
    cuts = [event for event in events if isinstance(event, ExtractEvent)]
    # the first pairs may end before the header is decoded
    assert [cut.number for cut in cuts][-9:] == list(range(4, 13))
    decoded = next(event for event in events if isinstance(event, DecodeEvent))
    assert decoded.luminances is not None
    for cut in cuts[1:]:
        shown = [_cells(frame, pose) for frame, pose in zip(cut.frames, cut.poses, strict=True)]
        like = np.corrcoef((shown[0] - shown[1]).ravel(), decoded.luminances[cut.number].ravel())[0, 1]
        assert like > 0.7


def _cells(frame: AnyFrame, pose: Pose) -> Floats:
    """Return gray levels at cell centres."""
    places = np.rint(pose.leds(16) - frame.origin).astype(int)
    return np.asarray(frame.pixels[places[..., 1], places[..., 0]], float)


@pytest.mark.slow
def test_any_chunks_give_the_same_packets_and_copies_do_no_harm() -> None:
    settings = link("phone-60", 1.2)
    film = frames(settings)
    twice = [one for k, frame in enumerate(film) for one in ([frame] if k % 9 else [frame, _copy(frame)])]
    receiver = heliograph.make_receiver(settings.signal, settings.receive)
    packets = [packet for frame in twice for packet in receiver.push(frame)] + list(receiver.finish())
    assert [packet.status for packet in packets] == ["ok"]


def _copy(frame: Frame) -> Frame:
    return replace(frame, time_s=frame.time_s + 0.003)


@pytest.mark.slow
def test_noise_is_no_array() -> None:
    rng, settings = np.random.default_rng(1), load_settings("phone")
    film = [Frame(k, k / 30, rng.integers(90, 110, (120, 160), dtype=np.uint8)) for k in range(40)]
    assert read(settings, film) == []


def test_what_it_cannot_read_is_refused() -> None:
    settings = load_settings("phone")
    with pytest.raises(SettingsError, match="the receiver screen reads"):
        heliograph.make_receiver(replace(settings.signal, modulation="ook"), settings.receive)
    with pytest.raises(SettingsError, match="has no effect"):
        load_settings("paper", None, ["receive.screen.gamma=2.0"])
