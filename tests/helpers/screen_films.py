"""Phone films of a screen, made from grabbed pictures independently of the package."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray

Gray = NDArray[np.uint8]
Light = NDArray[np.float32]
GAMMA = 2.2  # gamma of the screen and of the phone's pictures
TICKS = 90_000  # ticks per second in the film, typical for phones


@dataclass(frozen=True, slots=True)
class Grabs:
    """Screen content: (k, rows, columns) pictures, each of which stays until the next of (k,) ascending times."""

    times_s: NDArray[np.float64]
    pictures: Gray


@dataclass(frozen=True, slots=True, kw_only=True)
class Phone:
    """Phone camera model; the defaults are a hand-held phone before a laptop."""

    fps: float = 30.0
    width: int = 640  # of a frame
    height: int = 480
    side_px: float = 320.0  # of the screen picture in a frame
    exposure_s: float = 0.010  # of a row
    readout_s: float = 0.015  # delay from the first row to the last
    jitter_s: float = 0.002  # largest deviation from uniform frame times; the film has the true times
    shake_px: float = 2.0  # amplitude of the hand shake
    blur_px: float = 1.2  # standard deviation of the lens blur
    noise: float = 2.0  # standard deviation of a gray level
    glare: float = 0.03  # ambient light on the screen, as a fraction of full light
    gain: float = 1.0  # brightness relative to a correct exposure
    turn_deg: float = 0.0  # yaw of the screen from fronto-parallel
    off_px: float = 0.0  # displacement of the screen picture to the right
    mbit_s: float = 10.0  # bit rate of the film
    seed: int = 1  # for position, perspective, times and noise


def phone_frames(grabs: Grabs, phone: Phone) -> Iterator[tuple[float, Gray]]:
    """Yield time and gray levels for each frame during the grabs."""
    rng = np.random.default_rng(phone.seed)
    corners, phase, beat = screen_corners(phone, rng), rng.uniform(0, 2 * np.pi, 2), rng.uniform(0.6, 1.1, 2)
    first = float(grabs.times_s[0]) + rng.uniform(0, 1 / phone.fps)
    for k in range(10**9):
        time_s = first + k / phone.fps + rng.uniform(-1, 1) * phone.jitter_s
        if time_s + phone.exposure_s + phone.readout_s > grabs.times_s[-1]:
            return
        way = phone.shake_px * np.sin(2 * np.pi * beat * (time_s - first) + phase)
        light = _light(grabs, phone, time_s, corners + way)
        gray = 255 * np.clip(light, 0, 1) ** (1 / GAMMA) + rng.normal(0, phone.noise, light.shape)
        yield time_s - first, np.clip(np.rint(gray), 0, 255).astype(np.uint8)


def screen_corners(phone: Phone, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the image corners of the screen picture, each displaced from a square by up to 4 %."""
    middle = np.array([phone.width, phone.height]) / 2 + rng.uniform(-0.04, 0.04, 2) * phone.height
    turn = np.deg2rad(phone.turn_deg)
    square = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], np.float64) / 2  # at a viewing distance of 3.5 sides
    away = 1 + square[:, :1] * np.sin(turn) / 3.5
    square = square * (np.cos(turn), 1) / away * phone.side_px
    corners = middle + (phone.off_px, 0) + square + rng.uniform(-0.04, 0.04, (4, 2)) * phone.side_px
    return np.asarray(corners, np.float64)


def _light(grabs: Grabs, phone: Phone, time_s: float, corners: NDArray[np.float64]) -> Light:
    """Return (height, width) light; each row has a separate exposure interval."""
    rows = time_s + phone.readout_s * np.arange(phone.height) / phone.height
    ends = np.append(grabs.times_s[1:], np.inf)
    size = grabs.pictures.shape[2], grabs.pictures.shape[1]
    from_screen = np.array([(0, 0), (size[0], 0), size, (0, size[1])], np.float32)
    warp = cv2.getPerspectiveTransform(from_screen, corners.astype(np.float32))
    light = np.zeros((phone.height, phone.width), np.float32)
    for k in np.flatnonzero((ends > rows[0]) & (grabs.times_s < rows[-1] + phone.exposure_s)):
        seen_s = np.minimum(rows + phone.exposure_s, ends[k]) - np.maximum(rows, grabs.times_s[k])
        shown = (grabs.pictures[k].astype(np.float32) / 255) ** GAMMA
        seen = cv2.warpPerspective(shown, warp, (phone.width, phone.height), flags=cv2.INTER_AREA)
        light += seen * (np.maximum(seen_s, 0) / phone.exposure_s).astype(np.float32)[:, None]
    return phone.gain * (cv2.GaussianBlur(light, (0, 0), phone.blur_px) * (0.9 - phone.glare) + phone.glare)


def write_phone_film(path: Path, frames: Iterable[tuple[float, Gray]], phone: Phone) -> int:
    """Write frames with true times as H.264, in colour with limited range; return the frame count."""
    written = 0
    with av.open(str(path), "w") as out:
        stream = out.add_stream("libx264", rate=round(phone.fps))
        stream.width, stream.height, stream.pix_fmt = phone.width, phone.height, "yuv420p"
        stream.bit_rate, stream.time_base = int(phone.mbit_s * 1e6), Fraction(1, TICKS)
        stream.codec_context.time_base = Fraction(1, TICKS)
        stream.options = {"preset": "veryfast", "tune": "zerolatency"}
        stream.codec_context.color_range = 1  # limited
        for time_s, gray in frames:
            picture = av.VideoFrame.from_ndarray(gray[..., None].repeat(3, axis=2), "rgb24")
            coded = picture.reformat(format="yuv420p", dst_color_range="MPEG")
            coded.pts, coded.time_base = round(time_s * TICKS), Fraction(1, TICKS)
            out.mux(stream.encode(coded))
            written += 1
        out.mux(stream.encode())
    return written


def write_webcam(path: Path, frames: Iterable[tuple[float, Gray]]) -> int:
    """Write an MJPEG file for Chromium's fake webcam, which repeats it at 30 frames/s."""
    written = 0
    with path.open("wb") as out:
        for _, gray in frames:
            coded = cv2.imencode(".jpg", cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR), [cv2.IMWRITE_JPEG_QUALITY, 92])[1]
            written += out.write(coded.tobytes()) > 0
    return written
