"""Real footage and real shake: what is promised of the link holds on them, and nothing is found where nothing is."""

from collections import deque
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest

from heliograph.base.frames import Frame
from heliograph.link.film import is_packet, write_film
from heliograph.link.recordings import load_footage, load_imu
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import Recordings, default_messages, simulate
from heliograph.link.truth import open_truth, truth_path
from heliograph.measure.errors import ErrorCounter
from heliograph.measure.reception import Reception, receive_film
from heliograph.media import open_film
from heliograph.receive import Packet, Receiver

CLIPS = ("day-motorway", "day-shade", "night-road")

READ_FROM = {75: ("high",), 52: ("high", "middle"), 45: ("high", "middle", "low")}
"""Layers of which every codeword is read, by the distance in m at which the drive begins."""

MARGIN_PX = 16

NATIVE_FRAMES = 60
MOST_NATIVE_DETECTIONS = 3
"""In 60 frames: one in twenty. A false detection costs a little time, a right codeword out of one is a false word."""


def scene(data: Path, clip: str, *changes: str) -> tuple[LinkSettings, Recordings]:
    settings = load_settings("paper", None, ["channel.background.kind='footage'", "channel.shake='imu'", *changes])
    imu = load_imu(data / "motion" / "car-imu.csv")
    return settings, Recordings(footage=load_footage(data / "driving" / f"{clip}.mp4"), imu=imu)


def right(packets: list[Packet]) -> list[Packet]:
    """Packets with a codeword that passed for right, by status and by the codewords themselves."""
    return [
        p
        for p in packets
        if p.status in ("ok", "partial") or any(w.status == "ok" for words in p.layers.values() for w in words)
    ]


@pytest.mark.real_data
@pytest.mark.parametrize("distance_m", READ_FROM)
@pytest.mark.parametrize("clip", CLIPS)
def test_layers_are_read_over_real_footage_and_shake(data: Path, clip: str, distance_m: int) -> None:
    settings, recordings = scene(data, clip, f"channel.distance_m={distance_m}", "channel.duration_s=0.35")
    messages = default_messages(settings)
    errors, receiver = ErrorCounter(settings, messages), Receiver(settings.signal, settings.receive)
    packets = list[Packet]()
    for frame, truth in simulate(settings, messages, 1, recordings, roi_margin_px=MARGIN_PX):
        errors.saw(truth.time_s, [a.distance_m for a in truth.arrays], [a.visible for a in truth.arrays])
        packets += receiver.push(frame)
    packets += receiver.finish()
    for packet in packets:
        if is_packet(packet):
            errors.received(packet)
    total = errors.total()
    # three packets are filmed whole
    assert {n: e.codewords for n, e in total.items()} == {"high": 3, "middle": 6, "low": 3}
    assert {n: total[n].codeword_errors for n in READ_FROM[distance_m]} == dict.fromkeys(READ_FROM[distance_m], 0)
    assert errors.false_codewords == 0


def native(path: Path, period_s: float) -> Iterator[Frame]:
    """The clip's own frames, small, one a pattern: all moves forty times as fast, nothing is faded."""
    for index, pixels in enumerate(islice(load_footage(path).frames(), NATIVE_FRAMES)):
        small = np.asarray(cv2.resize(pixels, (480, 270), interpolation=cv2.INTER_AREA), np.uint8)
        yield Frame(index, index * period_s, small)


@pytest.mark.real_data
@pytest.mark.parametrize("clip", CLIPS)
def test_a_clip_played_natively_has_no_packet(data: Path, clip: str) -> None:
    # short packets: one that a false detection begins ends within the clip
    settings = load_settings("paper", None, ["signal.data_pairs=16"])
    receiver, packets, frames = Receiver(settings.signal, settings.receive), list[Packet](), 0
    for frame in native(data / "driving" / f"{clip}.mp4", settings.signal.pattern_period_s):
        packets += receiver.push(frame)
        frames += 1
    packets += receiver.finish()
    assert frames == NATIVE_FRAMES
    assert right(packets) == []
    assert receiver.detections <= MOST_NATIVE_DETECTIONS


@pytest.mark.real_data
@pytest.mark.parametrize("clip", CLIPS)
def test_a_film_without_any_array_has_no_detection(data: Path, clip: str) -> None:
    settings, recordings = scene(data, clip, "channel.arrays=[]", "transmit.identities=[]", "channel.duration_s=0.1")
    receiver, packets, frames = Receiver(settings.signal, settings.receive), list[Packet](), 0
    for frame, _ in simulate(settings, [], 3, recordings):
        packets += receiver.push(frame)
        frames += 1
    packets += receiver.finish()
    assert frames == 100
    assert right(packets) == []
    assert receiver.detections == 0


def test_a_lossy_film_gives_high_and_middle_layers(tmp_path: Path) -> None:
    small = (
        "channel.camera.width=192",
        "channel.camera.height=160",
        "channel.arrays.0.x_m=0",
        "channel.arrays.0.y_m=0",
    )
    settings = load_settings("paper", None, ["channel.distance_m=38", "channel.duration_s=0.31", *small])
    path = tmp_path / "lossy.mp4"
    write_film(path, settings, default_messages(settings), 5, crf=18)
    reception = Reception(open_truth(truth_path(path)))
    with open_film(path) as film:
        deque(receive_film(film, settings.signal, settings, reception), maxlen=0)
    assert reception.errors is not None
    words = {n: e.words for n, e in reception.errors.total().items()}
    assert [(words[n].trials, words[n].errors) for n in ("high", "middle")] == [(3, 0), (6, 0)]
    assert reception.errors.false_codewords == 0
