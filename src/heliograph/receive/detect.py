"""Detection: find arrays by the header that only they show.

The header and its inverse alternate, so four frames in a row combined as f0 - 3 f1 + 3 f2 - f3 keep the header and
cancel what stands still, drifts or accelerates evenly. What is left is correlated with the M-sequences of all
identities over scale and position; the best candidates are fitted to a fraction of a pixel and must alternate in
step from frame to frame.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.fit import Fit, Prior, fit_array, window_around
from heliograph.receive.pose import Pose
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.header import CELLS, all_header_cells
from heliograph.signal.settings import SignalSettings

BLOCK = 8
"""Pixels of a side of the blocks in which the search first asks whether anything alternates."""

SIDE_STEP = 1.12
"""Ratio of successive sizes looked for: half a step costs 3 % of correlation."""

COMB = 0.5
"""Pitches of blur that hide single LEDs while a candidate is centred: else it locks in a whole pitch beside them."""

UPRIGHT, TILTED = 0.01, 0.1
"""Standard deviations of stretch and of shear of candidates taken to face the camera and of others; 10 degrees of yaw
are a stretch of -0.008, 40 degrees of -0.13."""

CLEAR = 0.95
"""Score at which a candidate that faces the camera is not tried as a tilted one too."""

GAINED = 0.03
"""How much better a tilted candidate must be: what is left of an upright array, a side of it hidden, looks tilted."""

MOST_TILT = 0.2
"""Tilt of 48 degrees, beyond which LEDs hardly shine."""

HIDDEN, HIDDEN_SCORE, LIT_CELL = 0.32, 0.7, 0.4
"""Largest hidden share of an array that is found all the same; the least score of one worth the try; and alternation,
as a share of the median cell's, from which on a cell is not hidden."""

FIRST_SEEN, LIKE = 0.7, 0.9
"""Alternation and score of a header's first pair alone, as shares of the whole header's, from which on its pose is
taken: out of step a header may begin amid a frame, and noise counts for more in two frames than in four."""

SLACK = 2
"""Frames by which the start of the header may differ from the searched window's, either way."""


@dataclass(frozen=True, slots=True)
class Detection:
    """An array found by its header.

    Attributes
    ----------
    identity
        Its number.
    start_time_s
        When the header's first pattern began to be exposed.
    fit
        Pose and luminance at `time_s`, in the middle of the frames fitted.
    time_s
        Time of that pose.
    score
        Correlation with the header's image.
    regularity
        Weakest over mean alternation of the header's frames.
    shares
        (n, n) 1 where its LEDs shine, 0 in cells of the header that are hidden.
    """

    identity: int
    start_time_s: float
    fit: Fit
    time_s: float
    score: float
    regularity: float
    shares: NDArray[np.float64]


class Detector:
    """Looks for headers in a stream of frames.

    Parameters
    ----------
    settings
        The receiver's.
    signal
        The signal's: side of the array and header pairs.
    """

    def __init__(self, settings: ReceiveSettings, signal: SignalSettings):
        self._settings = settings
        self._side = signal.side
        # a lit square may be anything's; a tilted one all the more
        tilted = settings.detect.impaired and settings.detect.detector == "m_sequence"
        self._tilts = (UPRIGHT, TILTED) if tilted else (UPRIGHT,)
        self._header = 2 * signal.header_pairs
        self._cells = _templates(settings)
        self._sides = _sizes(settings.detect.min_side_px, settings.detect.max_side_px)
        self._span = min(self._header, 4)
        self._window = self._header + 2 * SLACK
        self._frames: deque[Frame] = deque(maxlen=self._window)
        self.candidates_fitted = 0

    @property
    def recent(self) -> Sequence[Frame]:
        """The last frames, oldest first: enough to hold the header of an array just found."""
        return self._frames

    def push(self, frame: Frame, taken: Sequence[Pose] = ()) -> list[Detection]:
        """Take a frame; return the arrays whose header lies in the last frames.

        Parameters
        ----------
        frame
            The next frame.
        taken
            Poses of arrays already followed; their surroundings are not searched.
        """
        if self._frames and not _follows(self._frames[-1], frame):
            self._frames.clear()
        if not self._frames:
            # a header may begin with the first frame: let that frame stand for those before it
            self._frames.extend(_before(frame, SLACK))
        self._frames.append(frame)
        every = 2 if self._header >= 4 else 1
        if len(self._frames) < self._window or frame.index % every:
            return []
        return self._search(list(self._frames), taken)

    def _search(self, frames: list[Frame], taken: Sequence[Pose]) -> list[Detection]:
        frames = _common(frames)
        if min(frames[0].pixels.shape) < self._sides[0]:
            return []
        window = frames[SLACK : SLACK + self._span]
        change = _change([f.pixels for f in window])
        origin = frames[0].origin
        busy = self._busy(change, origin, taken, frames[0].full_scale)
        if not busy.any():
            return []
        found = [self._refine(frames, change, row, taken) for row in self._coarse(change, busy, frames[0])]
        return _distinct([d for d in found if d is not None], self._side)

    def _busy(
        self, change: NDArray[np.float32], origin: tuple[int, int], taken: Sequence[Pose], full_scale: int
    ) -> NDArray[np.bool_]:
        """Blocks in which an array may have its centre: something alternates there, and no array is known there."""
        from heliograph.receive import kernels  # Numba is slow to import

        mean = np.empty((-(-change.shape[0] // BLOCK), -(-change.shape[1] // BLOCK)), dtype=np.float32)
        padded = cv2.copyMakeBorder(
            change, 0, mean.shape[0] * BLOCK - change.shape[0], 0, mean.shape[1] * BLOCK - change.shape[1], 0
        )
        kernels.block_means(padded, BLOCK, mean)
        for pose in taken:
            _blank(mean, pose, self._side, origin)
        floor = 2.0 * float(np.median(mean))
        least = max(0.25 * self._settings.detect.min_contrast * full_scale, floor)
        return np.asarray(cv2.dilate((mean > least).astype(np.uint8), np.ones((3, 3), np.uint8)), dtype=bool)

    def _coarse(self, change: NDArray[np.float32], busy: NDArray[np.bool_], frame: Frame) -> NDArray[np.float64]:
        """Best candidates (score, x, y, side, identity) of the window, best first."""
        from heliograph.receive import kernels

        total, square = cv2.integral2(change, sdepth=cv2.CV_64F, sqdepth=cv2.CV_64F)
        best = np.zeros((self._settings.detect.candidates, 5))
        detect = self._settings.detect
        contrast = 0.5 * detect.min_contrast * frame.full_scale
        corner = np.array(frame.origin, np.float64)
        count = kernels.search(
            total, square, busy, float(BLOCK), self._cells, self._sides, contrast, detect.coarse_score, corner, best
        )
        return best[:count]

    def _refine(
        self, frames: list[Frame], change: NDArray[np.float32], row: NDArray[np.float64], taken: Sequence[Pose]
    ) -> Detection | None:
        """Fit a candidate's pose, then ask when its header began and whether it alternates in step."""
        self.candidates_fitted += 1
        number, sign, origin = int(row[4]), float(np.sign(row[0])), frames[0].origin
        weights = self._weights(number)
        blur = self._settings.calibration.blur_px
        start = Pose(row[1] - 0.5 + origin[0], row[2] - 0.5 + origin[1], row[3] / self._side, 0.0, blur)
        if any(np.hypot(start.x - p.x, start.y - p.y) < 0.5 * self._side * p.pitch for p in taken):
            return None
        best: Detection | None = None
        for tilt in self._tilts:
            rough = _fit_window(change, origin, start, sign * weights, self._side, tilt, COMB)
            if rough is None or rough.score < self._settings.detect.coarse_score:
                break
            found = self._timed(frames, replace(rough.pose, blur=blur), weights, number, tilt)
            if found is not None and (best is None or found.score > best.score + GAINED):
                best = found
            if best is not None and best.score >= CLEAR:
                break
        return best

    def _timed(
        self, frames: list[Frame], pose: Pose, weights: NDArray[np.float64], number: int, tilt: float
    ) -> Detection | None:
        """Where the header begins, the start at which its frames alternate most; and the pose in just those frames."""
        seen = np.array([project(f, pose, weights) for f in frames])
        sign = 1 - 2 * (np.arange(self._header) % 2)
        sums = np.array([sign @ seen[k : k + self._header] for k in range(len(frames) - self._header + 1)])
        start = int(np.argmax(sums))
        if start == len(sums) - 1:
            # it may begin later still, and a pair of data like it stand for its first: the next search has more of it
            return None
        change = -np.diff(seen[start : start + self._header]) * sign[:-1]
        regularity = float(change.min() / max(change.mean(), 1e-9))
        header = frames[start : start + self._span]
        alternation, origin = _change([f.pixels for f in header]), header[0].origin
        fit = _fit_window(alternation, origin, pose, weights, self._side, tilt)
        shares: NDArray[np.float64] = np.ones(weights.shape)
        even = self._settings.detect.impaired and regularity >= self._settings.detect.hidden_regularity
        if fit is not None and HIDDEN_SCORE <= fit.score < CLEAR and even:
            lit = _lit_cells(alternation, origin, fit.pose, weights)
            part = np.kron(lit, np.ones((self._side // CELLS, self._side // CELLS)))
            rest = _fit_window(alternation, origin, fit.pose, part * weights, self._side, tilt)
            if rest is not None and lit.mean() >= 1 - HIDDEN and rest.score > fit.score:
                fit, shares = rest, np.asarray(part, np.float64)
        if fit is None or not self._convincing(fit, regularity, header[0].full_scale):
            return None
        if self._settings.detect.impaired and self._span > 2:
            # where a format is named the later pairs are dimmed unevenly: of a tilt only the first one tells
            first = _change([f.pixels for f in header[:2]])
            shape = _fit_window(first, origin, fit.pose, shares * weights, self._side, tilt)
            if shape is not None and shape.score > LIKE * fit.score and shape.gain > FIRST_SEEN * fit.gain:
                fit, header = replace(shape, score=fit.score), header[:2]
        middle = 0.5 * (header[0].time_s + header[-1].time_s)
        return Detection(number, header[0].time_s, fit, middle, fit.score, regularity, shares)

    def _convincing(self, fit: Fit, regularity: float, full_scale: int) -> bool:
        detect, side, half_step = self._settings.detect, self._side * fit.pose.pitch, SIDE_STEP**0.5
        bright = fit.gain >= detect.min_contrast * full_scale
        sized = detect.min_side_px / half_step <= side <= detect.max_side_px * half_step
        turned = np.hypot(fit.pose.stretch, fit.pose.shear) <= MOST_TILT
        whole = fit.score >= detect.score and regularity >= detect.regularity
        hidden = detect.impaired and fit.score >= detect.hidden_score and regularity >= detect.hidden_regularity
        return bool(bright and sized and turned and (whole or hidden))

    def _weights(self, number: int) -> NDArray[np.float64]:
        size = self._side // CELLS
        return np.kron(self._cells[number].reshape(CELLS, CELLS), np.ones((size, size)))


def project(frame: Frame, pose: Pose, weights: NDArray[np.float64]) -> float:
    """How much of a pattern of weights +-1 of mean 0 a frame shows: its amplitude in gray levels."""
    from heliograph.receive import kernels

    x0, y0, width, height = window_around(pose, weights.shape[0], 1.0)
    cut = cut_out(frame, x0, y0, width, height)
    model = np.empty((6, height, width))
    kernels.render(pose.full_vector(), weights, float(x0), float(y0), model)
    shape = model[0] - model[0].mean()
    return float((cut * shape).sum() / max((shape * shape).sum(), 1e-9))


def cut_out(frame: Frame, x0: int, y0: int, width: int, height: int) -> NDArray[np.float64]:
    """Pixels of a window on the sensor as float64; what lies beyond the frame repeats its border."""
    x, y = x0 - frame.origin[0], y0 - frame.origin[1]
    rows, cols = frame.pixels.shape
    if x >= 0 and y >= 0 and x + width <= cols and y + height <= rows:
        return frame.pixels[y : y + height, x : x + width].astype(np.float64)
    i = np.clip(np.arange(y, y + height), 0, rows - 1)
    j = np.clip(np.arange(x, x + width), 0, cols - 1)
    return frame.pixels[np.ix_(i, j)].astype(np.float64)


def _templates(settings: ReceiveSettings) -> NDArray[np.float64]:
    """Cells of the headers looked for, (identities, 16) of +-1; for the all-on detector a single filled square."""
    if settings.detect.detector == "all_on":
        return np.ones((1, CELLS * CELLS))
    return all_header_cells().reshape(-1, CELLS * CELLS).astype(np.float64)


def _sizes(smallest: float, largest: float) -> NDArray[np.float64]:
    count = int(np.ceil(np.log(largest / smallest) / np.log(SIDE_STEP))) + 1
    return np.geomspace(smallest, largest, count)


def _follows(last: Frame, frame: Frame) -> bool:
    return last.pixels.dtype == frame.pixels.dtype and last.bits == frame.bits and frame.index == last.index + 1


def _common(frames: list[Frame]) -> list[Frame]:
    """Frames cut to the window of the sensor that all of them show; a camera's window may follow the array."""
    if all(f.origin == frames[0].origin and f.pixels.shape == frames[0].pixels.shape for f in frames):
        return frames
    left, top = (max(f.origin[k] for f in frames) for k in (0, 1))
    right, low = (min(f.origin[k] + f.pixels.shape[1 - k] for f in frames) for k in (0, 1))
    return [_cropped(f, left, top, max(right, left), max(low, top)) for f in frames]


def _cropped(frame: Frame, left: int, top: int, right: int, low: int) -> Frame:
    x, y = frame.origin
    return replace(frame, pixels=frame.pixels[top - y : low - y, left - x : right - x].copy(), origin=(left, top))


def _before(frame: Frame, count: int) -> list[Frame]:
    """`count` copies of a frame with earlier, negative times and numbers."""
    return [replace(frame, index=frame.index - k, time_s=frame.time_s - 1e9 * k) for k in range(count, 0, -1)]


def _change(frames: list[NDArray[np.uint8] | NDArray[np.uint16]]) -> NDArray[np.float32]:
    """What alternates: the difference of two frames, or the third difference of four."""
    from heliograph.receive import kernels

    if len(frames) < 4:
        return frames[0].astype(np.float32) - frames[1]
    out = np.empty(frames[0].shape, dtype=np.float32)
    kernels.alternation(frames[0], frames[1], frames[2], frames[3], out)
    return out


def _blank(mean: NDArray[np.float32], pose: Pose, side: int, origin: tuple[int, int]) -> None:
    x0, y0, width, height = window_around(pose, side, BLOCK)
    i, j = max(0, (y0 - origin[1]) // BLOCK), max(0, (x0 - origin[0]) // BLOCK)
    mean[i : max(0, (y0 - origin[1] + height) // BLOCK + 1), j : max(0, (x0 - origin[0] + width) // BLOCK + 1)] = 0


def _fit_window(
    change: NDArray[np.float32],
    origin: tuple[int, int],
    start: Pose,
    weights: NDArray[np.float64],
    side: int,
    tilt: float,
    smooth: float = 0.0,
) -> Fit | None:
    """Fit near a start, to pixels blurred by `smooth` pitches."""
    x0, y0, width, height = window_around(start, side, 0.12 * side * start.pitch + 1)
    i, j = y0 - origin[1], x0 - origin[0]
    if i < 0 or j < 0 or i + height > change.shape[0] or j + width > change.shape[1]:
        return None
    image = change[i : i + height, j : j + width].astype(np.float64)
    sigma = smooth * start.pitch
    if sigma:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.float64)
        start = replace(start, blur=float(np.hypot(start.blur, sigma)))
    reach = 0.08 * side * start.pitch
    spread = np.diag(np.array([reach, reach, 0.1, 0.05, 0.2, tilt, tilt]) ** 2)
    return fit_array(image, (x0, y0), Prior(start.full_vector(), spread), weights, 6)


def _lit_cells(
    change: NDArray[np.float32], origin: tuple[int, int], pose: Pose, weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Which cells of the header of +-1 weights alternate as the others do, (CELLS, CELLS) of 0 and 1."""
    from heliograph.receive import kernels

    x0, y0, width, height = window_around(pose, len(weights), 1.0)
    i, j = max(0, y0 - origin[1]), max(0, x0 - origin[0])
    image = change[i : y0 - origin[1] + height, j : x0 - origin[0] + width].astype(np.float64)
    shapes, size, out = [], len(weights) // CELLS, np.empty((6, *image.shape))
    for cell in range(CELLS * CELLS):
        mask = np.zeros((CELLS, CELLS))
        mask.flat[cell] = 1
        kernels.render(
            pose.full_vector(),
            weights * np.kron(mask, np.ones((size, size))),
            float(origin[0] + j),
            float(origin[1] + i),
            out,
        )
        shapes.append(out[0].ravel().copy())
    light = np.linalg.lstsq(np.stack(shapes, 1), image.ravel(), rcond=None)[0]
    return np.asarray((light > LIT_CELL * np.median(light)).astype(float).reshape(CELLS, CELLS))


def _distinct(detections: list[Detection], side: int) -> list[Detection]:
    """One detection a place, the best."""
    kept: list[Detection] = []
    for one in sorted(detections, key=lambda d: -d.score):
        if all(apart(one.fit.pose, other.fit.pose, side) for other in kept):
            kept.append(one)
    return kept


def apart(a: Pose, b: Pose, side: int) -> bool:
    """Whether two arrays do not overlap, a tenth left for slips: parts of a header look like smaller ones."""
    return bool(np.hypot(a.x - b.x, a.y - b.y) > 0.45 * side * (a.pitch + b.pitch))
