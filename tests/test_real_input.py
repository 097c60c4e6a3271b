"""Films over real footage, with the recorded shake of a car: the headline claims, in little."""

from collections import deque
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest

from heliograph.base.frames import Frame
from heliograph.link.bench import run_block
from heliograph.link.film import receive_film, write_film
from heliograph.link.reception import Reception
from heliograph.link.recordings import load_footage, load_imu
from heliograph.link.settings import load_settings
from heliograph.link.simulate import Recordings, default_messages
from heliograph.link.truth import open_truth, truth_path
from heliograph.media import open_film
from heliograph.receive import Packet, Receiver
from heliograph.signal.settings import SignalSettings

CLIPS = ("day-motorway", "day-shade", "night-road")

READ_AT = {76.0: ("high",), 54.0: ("high", "middle"), 47.0: ("high", "middle", "low")}
"""Layers that arrive without error at a distance."""


def scene(data: Path, clip: str, *changes: str) -> tuple[list[str], Recordings]:
    recordings = Recordings(
        footage=load_footage(data / "driving" / f"{clip}.mp4"), imu=load_imu(data / "motion" / "car-imu.csv")
    )
    return ["channel.background.kind='footage'", "channel.shake='imu'", *changes], recordings


@pytest.mark.real_data
@pytest.mark.parametrize("clip", CLIPS)
@pytest.mark.parametrize("distance_m", READ_AT)
def test_layers_arrive_over_real_footage_and_shake(data: Path, clip: str, distance_m: float) -> None:
    changes, recordings = scene(
        data, clip, f"channel.distance_m={distance_m}", "channel.duration_s=0.302", "channel.imu_start_s=11"
    )
    counts = run_block(load_settings("paper", None, changes), 3, recordings)
    for layer in READ_AT[distance_m]:
        assert counts.layers[layer].codewords >= 3
        assert counts.layers[layer].codeword_errors == 0
    assert counts.false_codewords == 0


@pytest.mark.real_data
@pytest.mark.parametrize("clip", CLIPS)
def test_clip_played_a_frame_a_pattern_gives_no_packet(data: Path, clip: str) -> None:
    """Harsher than any drive: all motion forty times as fast, nothing faded from frame to frame."""
    signal = SignalSettings(data_pairs=16)
    receiver = Receiver(signal)
    packets: list[Packet] = []
    with open_film(data / "driving" / f"{clip}.mp4") as film:
        for frame in islice(film, 60):
            pixels = np.asarray(cv2.resize(frame.pixels, (480, 270), interpolation=cv2.INTER_AREA), np.uint8)
            packets += receiver.push(Frame(frame.index, frame.index * signal.pattern_period_s, pixels))
    packets += receiver.finish()
    words = [word for packet in packets for layer in packet.layers.values() for word in layer]
    assert all(word.status != "ok" for word in words)
    assert receiver.detections <= 3


def test_lossy_film_gives_high_and_middle_layers(tmp_path: Path) -> None:
    settings = load_settings("paper", None, [
        "channel.distance_m=38", "channel.duration_s=0.302", "channel.camera.width=192", "channel.camera.height=160",
        "channel.arrays.0.x_m=0", "channel.arrays.0.y_m=0",
    ])  # fmt: skip
    path = tmp_path / "lossy.mp4"
    write_film(path, settings, default_messages(settings), 5, crf=18)
    reception = Reception(open_truth(truth_path(path)))
    with open_film(path) as film:
        deque(receive_film(film, settings.signal, settings, reception), maxlen=0)
    assert reception.errors is not None
    for layer, words in (("high", 3), ("middle", 6)):
        assert reception.errors.total()[layer].codewords.trials == words
        assert reception.errors.total()[layer].codewords.errors == 0
    assert reception.errors.false_codewords == 0
