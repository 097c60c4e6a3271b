"""Frame loss, repetition and late timestamps between camera and receiver."""

from itertools import pairwise

import numpy as np
import pytest

from heliograph.base.frames import Frame
from heliograph.channel.camera import Transfer
from heliograph.channel.settings import CameraSettings


def frames(count: int, fps: float = 1000.0) -> list[Frame]:
    return [Frame(k, k / fps, np.full((2, 2), k % 251, np.uint8), origin=(k, 0)) for k in range(count)]


def deliver(camera: CameraSettings, count: int, seed: int = 1) -> list[Frame]:
    transfer = Transfer(camera, seed)
    return [out for f in frames(count, camera.fps) if (out := transfer(f)) is not None]


def test_frames_are_delivered_unless_dropped_which_leaves_gaps() -> None:
    sent, transfer = frames(5), Transfer(CameraSettings(), 0)
    assert all(transfer(f) is f for f in sent)
    out = deliver(CameraSettings(dropped=0.1), 2000)
    # five standard deviations at loss probability 0.1
    assert len(out) / 2000 == pytest.approx(0.9, abs=5 * np.sqrt(0.09 / 2000))
    assert all(f.pixels[0, 0] == f.index % 251 and f.time_s == f.index / 1000 for f in out)


def test_numbers_of_delivered_frames_have_no_gap() -> None:
    marked, counted = deliver(CameraSettings(dropped=0.1), 500), deliver(CameraSettings(dropped=0.1, gaps=False), 500)
    assert all(np.array_equal(a.pixels, b.pixels) for a, b in zip(marked, counted, strict=True))
    assert [(f.index, round(f.time_s * 1000)) for f in counted] == [(k, k) for k in range(len(counted))]


def test_a_repeated_frame_is_the_one_delivered_before() -> None:
    out = deliver(CameraSettings(repeated=0.1, dropped=0.05), 2000)
    copies = [(a, b) for a, b in pairwise(out) if np.array_equal(a.pixels, b.pixels)]
    assert len(copies) / 2000 == pytest.approx(0.1, abs=0.02)
    # repeated frames keep new timestamps and the source window
    assert all(b.time_s == b.index / 1000 and a.origin == b.origin for a, b in copies)


def test_jitter_moves_stamps_alone_and_in_order() -> None:
    out = deliver(CameraSettings(fps=4000, exposure_s=2e-4, jitter_s=5e-5), 4000)
    assert np.array([f.time_s - f.index / 4000 for f in out]).std() == pytest.approx(5e-5, rel=0.05)
    assert np.diff([f.time_s for f in out]).min() > 0
    assert [int(f.pixels[0, 0]) for f in out] == [k % 251 for k in range(4000)]


def test_accidents_depend_on_seed_and_frame_alone() -> None:
    camera = CameraSettings(dropped=0.1, jitter_s=1e-5)
    whole = {f.index: f.time_s for f in deliver(camera, 300)}
    late = Transfer(camera, 1)
    part = [out for f in frames(300)[200:] if (out := late(f)) is not None]
    assert all(whole[f.index] == f.time_s for f in part)
    assert whole != {f.index: f.time_s for f in deliver(camera, 300, seed=2)}
