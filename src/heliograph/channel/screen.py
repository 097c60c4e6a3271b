"""Image of the cells of a screen: squares without gaps, exposed row by row.

The light of pattern k at time t is X_k (S(t - t_k) - S(t - t_(k+1))) with the step response S(t) = 1 - exp(-t / tau) of
the display. A pixel row integrates the light over the exposure of the row, while the backlight is on.
"""

import cv2
import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.compiled import compiled
from heliograph.channel.exposure import Lighting
from heliograph.channel.psf import PointSpread
from heliograph.channel.scene import Box, Corner, Light
from heliograph.channel.settings import EmitterSettings
from heliograph.signal.pwm import SLOTS

SAMPLES = 3  # samples along a pixel side: the error of a cell edge is at most a ninth, before blur


def cell_light(lighting: Lighting, emitter: EmitterSettings, starts_s: Floats, exposure_s: float) -> Floats:
    """Return the relative light of all cells during the exposure of each pixel row, (rows, n, n)."""
    n, period = lighting.feed.side, lighting.period_s
    scan = emitter.scan_s * np.arange(n) / n if emitter.scan_s else np.zeros(1)
    reach = 8.0 * emitter.response_s + scan[-1]  # 3e-4 of a step is left
    first = int(np.floor((starts_s.min() - reach - lighting.start_s) / period))
    last = int(np.floor((starts_s.max() + exposure_s - lighting.start_s) / period))
    patterns = [(k, pattern) for k in range(first, last + 1) if (pattern := lighting.feed.at(k)) is not None]
    if not patterns:
        return np.zeros((len(starts_s), n, n))
    begins = lighting.start_s + np.array([k for k, _ in patterns]) * period
    shown = np.stack([lighting.faults.visible(pattern / SLOTS) for _, pattern in patterns])
    for off_s, on_s in lighting.faults.off_s:  # at mid-pattern
        shown[(begins + period / 2 >= off_s) & (begins + period / 2 < on_s)] = 0
    # the rows of the display change in turn
    since = starts_s[:, None, None] - begins - scan[:, None]
    weights = _weights(since, period, emitter, exposure_s, starts_s[:, None, None])
    weights = np.broadcast_to(weights, (len(starts_s), n, len(patterns)))
    return np.asarray(np.einsum("ruk,kuv->ruv", weights, shown, optimize=True))


def _weights(since: Floats, period_s: float, emitter: EmitterSettings, exposure_s: float, starts_s: Floats) -> Floats:
    """Return the mean light of each pattern in an exposure a time after the pattern, (rows, scan, patterns)."""
    total = np.zeros(since.shape)
    for low, high in _lit_parts(starts_s, emitter, exposure_s):
        for sign, late in ((1, 0.0), (-1, period_s)):
            a, b = (_response(since + edge - late, emitter.response_s) for edge in (low, high))
            total += sign * (b - a)
    return total / (exposure_s * (emitter.backlight_duty if emitter.backlight_hz else 1.0))


def _lit_parts(starts_s: Floats, emitter: EmitterSettings, exposure_s: float) -> list[tuple[Floats, Floats]]:
    """Return the intervals of an exposure with the backlight on, relative to the start."""
    if not emitter.backlight_hz:
        return [(np.zeros_like(starts_s), np.full_like(starts_s, exposure_s))]
    cycle = 1 / emitter.backlight_hz
    begun = np.floor(starts_s / cycle) * cycle - starts_s
    parts = []
    for j in range(int(np.ceil(exposure_s / cycle)) + 1):
        low = np.clip(begun + j * cycle, 0, exposure_s)
        parts.append((low, np.maximum(low, np.clip(begun + (j + emitter.backlight_duty) * cycle, 0, exposure_s))))
    return parts


def _response(t: Floats, tau: float) -> Floats:
    """Return the integral of the step response from 0 to t: t - tau (1 - exp(-t / tau))."""
    t = np.maximum(t, 0)
    return t + tau * np.expm1(-t / tau) if tau else t


def add_screen(
    light: Light, corner: Corner, box: Box, inverses: Floats, cells: Floats, pitch_m: float, psf: PointSpread
) -> None:
    """Add the light of the cells to a window of the image, in place."""
    # 4 sigma: 6e-5 of the light is lost at an edge
    margin = int(np.ceil(4.0 * float(psf.sigma_px.max() + np.abs(psf.shift_px).max()))) + 1
    sharp = np.zeros((box[3] - box[1] + 1 + 2 * margin, box[2] - box[0] + 1 + 2 * margin), np.float32)
    fill_cells(sharp, margin, (box[0], box[1]), inverses, cells, pitch_m)
    left, top = box[0] - margin - corner[0], box[1] - margin - corner[1]
    rows, columns = (max(0, -edge) for edge in (top, left))
    height = min(sharp.shape[0], light.shape[0] - top) - rows
    width = min(sharp.shape[1], light.shape[1] - left) - columns
    if height <= 0 or width <= 0:
        return
    for fraction, (dx, dy), sigma in zip(psf.fraction.tolist(), psf.shift_px, psf.sigma_px.tolist(), strict=True):
        blurred = cv2.GaussianBlur(sharp, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
        if dx or dy:
            moved = np.array([[1.0, 0.0, dx], [0.0, 1.0, dy]])
            blurred = cv2.warpAffine(blurred, moved, (sharp.shape[1], sharp.shape[0]))
        part = np.asarray(blurred)[rows : rows + height, columns : columns + width]
        light[top + rows : top + rows + height, left + columns : left + columns + width] += np.float32(fraction) * part


@compiled()
def fill_cells(out: Light, margin: int, corner: Corner, inverses: Floats, cells: Floats, pitch: float) -> None:
    """Write the mean light of the cells in each pixel of a box."""
    n = cells.shape[1]
    for i in range(cells.shape[0]):
        y = corner[1] + i
        for j in range(out.shape[1] - 2 * margin):
            x, total = corner[0] + j, 0.0
            for s in range(SAMPLES * SAMPLES):
                h = inverses[i, s]
                px = x + (s % SAMPLES + 0.5) / SAMPLES - 0.5
                py = y + (s // SAMPLES + 0.5) / SAMPLES - 0.5
                w = h[2, 0] * px + h[2, 1] * py + h[2, 2]
                v = int(np.floor((h[0, 0] * px + h[0, 1] * py + h[0, 2]) / w / pitch + n / 2))
                u = int(np.floor((h[1, 0] * px + h[1, 1] * py + h[1, 2]) / w / pitch + n / 2))
                if 0 <= u < n and 0 <= v < n:
                    total += cells[i, u, v]
            out[i + margin, j + margin] = np.float32(total / SAMPLES**2)
