"""Frame validation: one-line errors for invalid frames and mixed cameras."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.receive.api import make_receiver
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings

GRAY = np.zeros((32, 64), np.uint8)

WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "colours": ({"pixels": np.zeros((32, 64, 3), np.uint8)}, "turn colours into gray"),
    "fractions": ({"pixels": np.zeros((32, 64))}, "uint8 or uint16, not float64"),
    "wide integers": ({"pixels": np.zeros((32, 64), np.int32)}, "uint8 or uint16, not int32"),
    "foreign order of bytes": ({"pixels": np.zeros((32, 64), ">u2"), "bits": 16}, "not >u2"),
    "masked pixels": ({"pixels": np.ma.masked_less(np.arange(6, dtype=np.uint8)[None], 2)}, "2 pixels .* masked"),
    "a buffer": ({"pixels": memoryview(bytes(6))}, "a NumPy array, not memoryview"),
    "no array": ({"pixels": [[1, 2]]}, "a NumPy array, not list"),
    "bits of another type": ({"pixels": GRAY.astype(np.uint16)}, "uint16 have 9 to 16 bits, not 8"),
    "too many bits": ({"bits": 99}, "uint8 have 8 bits, not 99"),
    "no number of bits": ({"bits": None}, "uint8 have 8 bits, not NoneType"),
    "no time": ({"time_s": float("nan")}, "time in seconds, at most 1e.10, not nan"),
    "an endless time": ({"time_s": float("inf")}, "not inf"),
    "a time in ns": ({"time_s": 1.8e18}, "not 1.8e.18"),
    "a time in text": ({"time_s": "0.1"}, "not '0.1'"),
    "a complex time": ({"time_s": np.complex128(1)}, "time in seconds"),
    "half a number": ({"index": 0.5}, "its number, a whole one, not 0.5"),
    "a huge number": ({"index": 1 << 80}, "its number, a whole one"),
    "no corner": ({"origin": None}, "origin is a tuple .x, y. of whole pixels, not NoneType"),
    "half a corner": ({"origin": (1, 0.5)}, "of whole pixels"),
}


@pytest.mark.parametrize(("changes", "says"), WRONG.values(), ids=WRONG)
def test_invalid_frame_is_reported_in_one_line(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(HeliographError, match=says):
        Frame(**{"index": 0, "time_s": 0.0, "pixels": GRAY, **changes})


def test_numbers_of_numpy_windows_and_large_views_are_frames() -> None:
    wide = Frame(np.int64(3), np.float32(0.5), GRAY[:, ::2].astype(np.uint16), np.int64(12), (np.int32(4), 2))  # type: ignore[arg-type]
    assert wide.full_scale == 4095
    Frame(0, 0.0, np.broadcast_to(np.zeros((), np.uint8), (1 << 20, 1 << 20)))  # an hour of reading


@pytest.mark.parametrize("make", [np.ma.masked_array, lambda pixels: pixels.view(np.recarray)])
def test_a_subclass_of_arrays_becomes_an_array(make: Callable[[Any], Any]) -> None:
    pixels = Frame(0, 0.0, make(GRAY.copy())).pixels
    assert (type(pixels), pixels.tolist()) == (np.ndarray, GRAY.tolist())


def test_a_copy_of_a_frame_lies_row_after_row_in_memory() -> None:
    pixels = np.arange(6, dtype=np.uint8).reshape(3, 2)
    frame = Frame(1, 0.5, pixels.T[::-1], 8, (3, 4))
    copy = frame.copied()
    assert (copy.index, copy.time_s, copy.bits, copy.origin) == (1, 0.5, 8, (3, 4))
    assert copy.pixels.flags.c_contiguous
    assert copy.pixels.tolist() == [[1, 3, 5], [0, 2, 4]]
    pixels[:] = 0
    assert copy.pixels.any()


@pytest.mark.parametrize(("receiver", "change", "says"), [
    ("plain", lambda frame: replace(frame, pixels=frame.pixels[:20]), "64x20 after 64x32 pixels"),
    ("soft", lambda frame: replace(frame, pixels=frame.pixels.astype(np.uint16), bits=12), "same bits"),
    ("plain", lambda frame: replace(frame, pixels=frame.pixels[:0]), "frame 3 has no pixels"),
    ("soft", lambda frame: frame.pixels, "takes heliograph.Frame, not ndarray"),
])  # fmt: skip
def test_frames_of_one_receiver_are_of_one_camera(receiver: str, change: Callable[[Frame], Any], says: str) -> None:
    taker = make_receiver(SignalSettings(), ReceiveSettings(receiver=receiver))
    noise = np.random.default_rng(0).integers(0, 99, (5, 32, 64), dtype=np.uint8)
    frames = [Frame(k, k / 1000, pixels) for k, pixels in enumerate(noise[:4])]
    for frame in frames[:3]:
        list(taker.push(frame))
    with pytest.raises(HeliographError, match=says):
        list(taker.push(change(frames[3])))
    # the receiver ignores the rejected frame, and windows may change their size
    assert not list(taker.push(Frame(4, 0.004, noise[4, 4:, 1:], origin=(1, 4))))
    assert not list(taker.finish())


@pytest.mark.parametrize(("image", "changes", "expected"), [
    (GRAY + 7, {}, (np.uint8, 8, 7)),
    (np.full((2, 3, 3), (10, 20, 30), np.uint8), {}, (np.uint8, 8, round(0.299 * 10 + 0.587 * 20 + 0.114 * 30))),
    (np.full((2, 3, 4), 4000, np.uint16), {"bits": 12}, (np.uint16, 12, 4000)),
    (np.full((2, 3), 0.5), {}, (np.uint16, 16, 32768)), (np.full((2, 3), 1.5), {"bits": 8}, (np.uint8, 8, 255)),
    ([[0.25, 0.25]], {"bits": 12}, (np.uint16, 12, 1024)),
])  # fmt: skip
def test_images_of_other_libraries_become_frames(image: Any, changes: Any, expected: tuple[Any, int, int]) -> None:
    frame = Frame.from_array(image, 5, rate_hz=1000, **changes)
    assert (frame.pixels.dtype, frame.bits, int(frame.pixels[0, 0])) == expected
    assert (frame.index, frame.time_s) == (5, 0.005)


@pytest.mark.parametrize("times", [{}, {"time_s": 0.1, "rate_hz": 1000}, {"rate_hz": 0}])
def test_an_image_needs_a_time_or_a_rate(times: Any) -> None:
    with pytest.raises(HeliographError, match="either time_s"):
        Frame.from_array(GRAY, **times)
