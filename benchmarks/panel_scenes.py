"""Random hand-held films with LED panels of other systems, rendered independently of the package.

A scene has a panel with text or random bits, row scan, tilt, hand shake, blur, bloom, saturation, clutter, and JPEG
or palette noise. Family 0 is for tuning; family 1, with other clutter, noise and motion, is for measurement.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Colours = NDArray[np.uint8]

SHAPES = ((8, 8), (8, 32), (16, 16), (16, 32), (32, 32))
WORDS = ("HELLO 2024", "NEXT STOP 12:45", "OPEN", "Exit 7 -> A9", "42 C  18%", "SALE! 50%", "wifi: guest", "ABCDEFGH")
DOT_PX = 9
"""LED side in px on the rendered board."""
FINER = 2
"""Rendered px per camera px."""


@dataclass(frozen=True)
class Scene:
    """Panel film and true LED positions.

    `frames` has (height, width, 3) colours; `corners` is (frames, 4, 2) in px; `lit` is the mean fraction of lit
    LEDs.
    """

    rows: int
    columns: int
    frames: list[Colours]
    corners: Floats
    lit: float
    pitch: float
    text: bool

    def leds(self, corners: Floats) -> Floats:
        """Return LED centres (rows * columns, 2) in px for given panel corners."""
        unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
        x, y = np.meshgrid((np.arange(self.columns) + 0.5) / self.columns, (np.arange(self.rows) + 0.5) / self.rows)
        view = cv2.getPerspectiveTransform(unit, corners.astype(np.float32))
        points = np.stack([x.ravel(), y.ravel()], axis=1)[None]
        return np.asarray(cv2.perspectiveTransform(points, view)[0])

    def error_pitches(self, corners: Floats) -> float:
        """Return the largest LED position error in pitches."""
        off = self.leds(np.asarray(corners)) - self.leds(self.corners[0])
        return float(np.linalg.norm(off, axis=1).max() / self.pitch)


def draw_scene(seed: int, family: int = 0, count: int = 6) -> Scene:
    rng = np.random.default_rng([seed, family, 40])
    rows, columns = SHAPES[rng.integers(len(SHAPES))]
    pitch = min(rng.uniform(3.5, 12.0), 440 / columns, 260 / rows)
    text = rng.random() < 0.5
    share = rng.uniform(0.05, 0.5)
    patterns = _text_patterns(rng, rows, columns, count) if text else rng.random((count, rows, columns)) < share
    weights = _scan_weights(rng, rows, count)
    width, height = (int(n * pitch + rng.uniform(3, 9) * pitch + 20) for n in (columns, rows))
    corners = _corners(rng, rows, columns, pitch, width, height)
    way = _hand(rng, family, count, pitch)
    tracks = corners + way[:, None]
    background = _background(rng, family, height, width)
    colour = rng.uniform(0.1, 1.0, 3)
    colour /= colour.max()
    camera = _Camera(rng, family, pitch)
    gains = 1 + 0.08 * rng.normal(size=(rows, columns))
    board_margin, board_level = rng.uniform(0, 1.0), rng.uniform(0, 0.5)
    frames = []
    for k in range(count):
        light = patterns[k] * weights[k][:, None] * gains
        noise = np.random.default_rng([seed, family, k])
        frames.append(camera.frame(light, tracks[k], background, colour, board_margin, board_level, noise))
    return Scene(rows, columns, frames, tracks, float(patterns.mean()), pitch, text)


def _text_patterns(rng: np.random.Generator, rows: int, columns: int, count: int) -> NDArray[np.bool_]:
    """Draw text that scrolls by zero to two columns per frame."""
    word = " ".join(rng.permutation(WORDS)[:4])
    size = min(rows, 16)
    strip = np.zeros((size * 3, 12 * size + columns + 40 * size), np.uint8)
    thickness = 1 if size < 16 or rng.random() < 0.7 else 2
    cv2.putText(strip, word, (2, 2 * size), cv2.FONT_HERSHEY_PLAIN, size / 11.0, 255, thickness)
    used = np.flatnonzero((strip > 100).any(axis=1))
    line = strip[used[0] : used[-1] + 1] > 100
    spare = rows - len(line)
    top = rng.integers(0, spare + 1) if spare > 0 else 0
    whole = np.zeros((rows, line.shape[1]), bool)
    part = line[:rows]
    whole[top : top + len(part)] = part
    if rows == 32 and rng.random() < 0.7:  # two text lines
        whole = np.zeros((rows, line.shape[1]), bool)
        whole[1 : 1 + min(len(line), 15)] = line[:15]
        whole[17 : 17 + min(len(line), 15)] = np.roll(line, -9, axis=1)[:15]
    step, begin = rng.integers(0, 3), rng.integers(0, 4 * size)
    return np.stack([whole[:, begin + k * step :][:, :columns] for k in range(count)])


def _scan_weights(rng: np.random.Generator, rows: int, count: int) -> Floats:
    """Return row brightness (frames, rows) for a row scan."""
    mode = rng.integers(4)
    k, row = np.arange(count)[:, None], np.arange(rows)[None]
    if mode == 0:
        return np.ones((count, rows))
    if mode == 1:  # a dimmer band, at a different position in each frame
        start = rng.integers(rows)
        inside = (row - start - k * rng.integers(1, rows)) % rows < rows * rng.uniform(0.2, 0.5)
        return np.where(inside, rng.uniform(0.3, 0.8), 1.0)
    if mode == 2:  # two halves scanned at once
        half = rows // 2
        phase = ((row % half) / half + k * rng.uniform(0, 1)) % 1
        return np.where(phase < 0.6, 1.0, rng.uniform(0.2, 0.7))
    lines = rng.choice([2, 4])
    return np.where((row + k) % lines == 0, rng.uniform(0.3, 0.8), 1.0)


def _corners(rng: np.random.Generator, rows: int, columns: int, pitch: float, width: int, height: int) -> Floats:
    """Draw corners for a rotated, tilted panel inside the picture."""
    unit = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    plane = unit * [columns * pitch, rows * pitch]
    tilt = rng.uniform(-0.12, 0.12, 2)
    far = 1 + unit @ tilt
    turn = rng.normal(0, 0.05)
    squeeze = rng.uniform(0.85, 1.0, 2)
    view = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    seen = (plane * squeeze / far[:, None]) @ view.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    margin = 0.7 * pitch
    spare = np.array([width, height]) - (high - low) - 2 * margin
    return np.asarray(seen - low + margin + spare.clip(0) * rng.uniform(0.1, 0.9, 2))


def _hand(rng: np.random.Generator, family: int, count: int, pitch: float) -> Floats:
    """Return hand shake (frames, 2) in px: a random walk, or a sway."""
    if family == 0:
        return np.cumsum(rng.normal(0, 0.08 * pitch, (count, 2)), axis=0)
    k = np.arange(count)[:, None]
    return 0.4 * pitch * np.sin(k * rng.uniform(0.2, 0.9, 2) + rng.uniform(0, 6, 2)) * rng.uniform(0.2, 1.0)


def _background(rng: np.random.Generator, family: int, height: int, width: int) -> Floats:
    """Draw the background, (height, width) gray levels."""
    level = rng.uniform(5, 90)
    out = np.full((height, width), level)
    patches = cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), rng.uniform(5, 25))
    out = out * (1 + 0.5 * patches / patches.std()).clip(0.1)
    for _ in range(rng.integers(0, 8)):
        x, y = int(rng.integers(0, width)), int(rng.integers(0, height))
        if family == 0:
            wide, high = (int(n) for n in rng.integers(5, 80, 2))
            cv2.rectangle(out, (x, y), (x + wide, y + high), float(rng.uniform(0, 140)), -1)
        else:
            end = rng.integers(0, width), rng.integers(0, height)
            cv2.line(out, (x, y), (int(end[0]), int(end[1])), float(rng.uniform(0, 140)), int(rng.integers(1, 9)))
    if family == 1 and rng.random() < 0.5:  # blinds or bricks
        period, turn = rng.uniform(4, 20), rng.uniform(0, 3)
        y, x = np.mgrid[:height, :width]
        out += rng.uniform(5, 30) * np.sign(np.sin(2 * np.pi * (x * np.cos(turn) + y * np.sin(turn)) / period))
    for _ in range(rng.integers(0, 3)):
        at = int(rng.integers(0, width)), int(rng.integers(0, height))
        cv2.circle(out, at, int(rng.integers(1, 8)), float(rng.uniform(120, 300)), -1)
    return np.asarray(out.clip(0))


class _Camera:
    """Camera with blur, bloom, saturation, noise and lossy formats."""

    def __init__(self, rng: np.random.Generator, family: int, pitch: float) -> None:
        self.emitter = rng.uniform(0.3, 0.7)
        self.blur_px = max(pitch * rng.uniform(0.1, 0.38), 0.5)
        self.bloom = rng.uniform(0.05, 0.65)
        self.bloom_px = pitch * rng.uniform(0.8, 3.0)
        self.peak = 255 * np.exp(rng.uniform(np.log(0.4), np.log(6.0)))
        self.noise = rng.uniform(0.5, 5.0)
        self.gamma = rng.choice([1.0, 1 / 2.2])
        self.loss = rng.choice(["none", "jpeg", "palette"])
        self.quality = int(rng.uniform(35, 95))
        self.shades = int(rng.integers(12, 64))
        self.family = family

    def frame(
        self, light: Floats, corners: Floats, background: Floats, colour: Floats, margin: float, board: float,
        rng: np.random.Generator,
    ) -> Colours:  # fmt: skip
        height, width = background.shape
        y, x = np.mgrid[:DOT_PX, :DOT_PX] - (DOT_PX - 1) / 2
        dot = (np.hypot(x, y) < max(self.emitter * DOT_PX / 2, 1.0)).astype(np.float64)
        dot /= dot.mean()
        texture = np.kron(light, dot)
        rows, columns = light.shape
        edge = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]]) * DOT_PX - 0.5
        finer = (corners + 0.5) * FINER - 0.5
        view = cv2.getPerspectiveTransform(edge.astype(np.float32), finer.astype(np.float32))
        size = width * FINER, height * FINER
        shown = cv2.warpPerspective(cv2.GaussianBlur(texture, (0, 0), 1.0), view, size)
        shown = cv2.resize(shown, (width, height), interpolation=cv2.INTER_AREA)
        narrow = cv2.GaussianBlur(shown, (0, 0), self.blur_px)
        wide = cv2.GaussianBlur(shown, (0, 0), self.bloom_px)
        far = cv2.GaussianBlur(shown, (0, 0), 3 * self.bloom_px)
        # `peak` is the level at the centre of a single LED
        pitch = np.linalg.norm(corners[1] - corners[0]) / columns
        single = pitch**2 / (2 * np.pi * (self.blur_px**2 + 0.3))
        glow = ((1 - self.bloom) * narrow + self.bloom * (0.7 * wide + 0.3 * far)) / min(single, 1 / 0.2) * self.peak
        rim = cv2.getPerspectiveTransform(edge.astype(np.float32), corners.astype(np.float32))
        grown = edge + 0.5 + margin * DOT_PX * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        outline = cv2.perspectiveTransform(grown[None].astype(np.float64), rim)[0]
        cover = np.zeros((height, width), np.uint8)
        cv2.fillConvexPoly(cover, np.rint(outline * 16).astype(np.int32), 1, shift=4)
        behind = np.where(cover, background.mean() * board, background)
        image = glow[..., None] * colour + behind[..., None]
        noise = rng.normal(size=image.shape) * self.noise
        if self.family == 1:  # shot noise, and noise correlated between neighbouring pixels
            noise = cv2.GaussianBlur(noise, (0, 0), 0.6) * 1.5 * np.sqrt(0.5 + image.clip(0, 255) / 200)
        image = np.clip(image + noise, 0, 255)
        if self.gamma != 1:
            image = 255 * (image / 255) ** (0.7 if self.family == 0 else 0.6)
        out = np.rint(image).astype(np.uint8)
        if self.loss == "jpeg":
            out = cv2.imdecode(cv2.imencode(".jpg", out, [cv2.IMWRITE_JPEG_QUALITY, self.quality])[1], cv2.IMREAD_COLOR)
        elif self.loss == "palette":
            step = 255 / self.shades
            dither = (
                rng.uniform(-0.5, 0.5, out.shape)
                if self.family
                else np.array([[-0.4, 0.1], [0.35, -0.15]])[np.ix_(np.arange(height) % 2, np.arange(width) % 2)][
                    ..., None
                ]
            )
            out = np.clip(np.rint(out / step + dither) * step, 0, 255).astype(np.uint8)
        return np.asarray(out, np.uint8)
