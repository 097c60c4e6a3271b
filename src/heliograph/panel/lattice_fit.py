"""A panel's corners and blur fitted to a picture, whatever its LEDs show."""

import numpy as np

from heliograph.base.arrays import RCOND, TINY, Floats
from heliograph.base.errors import HeliographError
from heliograph.panel.lattice import LEAST_BLUR_PX, MOST_BLUR, PIXEL_VARIANCE_PX2, Fitted, Lattice, Shape
from heliograph.panel.picture import Levels
from heliograph.panel.place import is_possible

STEPS = 12
"""Most steps of a fit. Chosen: it bounds the time of what does not converge."""

ENOUGH_PX = 0.01
"""Step of a corner in px that ends a fit. A tolerance: it moves an LED's peak by 1e-4 of itself."""

ENOUGH_BLUR = 3e-3
"""Step of ln blur that ends a fit. A tolerance: it changes an LED's peak by 0.6 %."""

LONGEST_STEP = 0.3
"""Longest step of a corner in pitches, and of ln blur: farther the image is not linear in it."""

HOLD = 1e-3
"""Added to each change's power, as a fraction of it: what the picture does not show stays as it is."""

SAME_SIZE_PX, SAME_BLUR = 0.1, 1e-3
"""Change of a corner in px and of ln blur within which the overlap of LEDs is not computed again.

A side of 100 px then changes by 1e-3 of itself, as sigma does. With the overlap of a blur 1 % wider a fit did not end.
"""


def fitted(image: Levels, start: Fitted, shape: Shape, steps: int = STEPS, enough_px: float = ENOUGH_PX) -> Fitted:
    """Fit a panel's corners and blur to a picture whatever its LEDs show, by Gauss-Newton."""
    mask = shape.mask(start.corners, (image.shape[0], image.shape[1]))
    best = _Seen(image, mask, start, shape)
    hessian = start.hessian if start.hessian is not None else best.hessian()
    fresh = start.hessian is None
    change = _change(hessian, best.gradient, LONGEST_STEP * shape.pitch(start.corners))
    for _ in range(steps):
        if np.abs(change[:-1]).max() < enough_px and abs(change[-1]) < ENOUGH_BLUR:
            break
        # neighbours stay as far apart as they are while the blur stays
        same = np.abs(change[:-1]).max() < SAME_SIZE_PX and abs(change[-1]) < SAME_BLUR
        factor = best.lattice.factor if same else None
        moved = _moved(best.fit, change, shape)
        if not is_possible(moved.corners, shape.rows, shape.columns):
            break
        try:
            tried = _Seen(image, mask, moved, shape, factor)
        except HeliographError:  # the blur no longer tells LEDs apart
            break
        if tried.fit.score >= best.fit.score:
            best = tried
            hessian = best.hessian() if fresh else hessian
        elif fresh:
            change = change / 2
            continue
        elif np.abs(change[:-1]).max() < SAME_SIZE_PX:
            break
        else:  # the power of another picture led astray
            hessian, fresh = best.hessian(), True
        change = _change(hessian, best.gradient, LONGEST_STEP * shape.pitch(best.fit.corners))
    return best.fit._replace(hessian=hessian)


class _Seen:
    """A picture seen with a panel at a place."""

    def __init__(self, image: Levels, mask: Levels, at: Fitted, shape: Shape, factor: Floats | None = None):
        self.lattice = Lattice(shape, at.corners, at.blur, mask, factor)
        seen = image * mask
        light, background = self.lattice.light(seen[None])
        self._light = light[:, 0]
        self._rest = seen - self.lattice.image(self._light, background[:, 0])
        self._power = max(float(self._light @ self._light) / len(self._light), TINY)
        self.fit = at._replace(score=_correlation(image, self._rest, mask))

    @property
    def gradient(self) -> Floats:
        """Of the explained power by corners and ln sigma, (9,), for LEDs of the mean squared light 1."""
        return self.lattice.gradient(self._rest, self._light) / self._power

    def hessian(self) -> Floats:
        """Its power, (9, 9)."""
        return self.lattice.hessian(self._light) / self._power


def _change(hessian: Floats, gradient: Floats, longest_px: float) -> Floats:
    """Step (9,) of corners and ln sigma, no longer than the image is linear in it."""
    held = np.diag(np.diag(hessian)) * HOLD
    # what shows no light has no change either
    change = np.linalg.lstsq(hessian + held, gradient, rcond=RCOND)[0]
    return np.asarray(change / max(np.abs(change[:-1]).max() / longest_px, abs(change[-1]) / LONGEST_STEP, 1.0))


def _moved(at: Fitted, change: Floats, shape: Shape) -> Fitted:
    """A fit moved by a step; what grows is sigma, of which the pixel's width is a part."""
    wide = (at.blur**2 + PIXEL_VARIANCE_PX2) * np.exp(2 * change[-1]) - PIXEL_VARIANCE_PX2
    most = max(MOST_BLUR * shape.pitch(at.corners), LEAST_BLUR_PX)
    blur = float(np.clip(np.sqrt(max(wide, 0.0)), LEAST_BLUR_PX, most))
    return at._replace(corners=at.corners + change[:-1].reshape(4, 2), blur=blur)


def _correlation(image: Levels, rest: Levels, mask: Levels) -> float:
    inside = mask > 0
    shown = image[inside].astype(np.float64)
    total = float(((shown - shown.mean()) ** 2).sum()) if shown.size else 0.0
    left = float((rest[inside].astype(np.float64) ** 2).sum())
    return float(np.sqrt(max(1 - left / max(total, TINY), 0.0)))
