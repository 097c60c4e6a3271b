"""LEDs of a panel in a picture: their light by least squares, and the fit of corners and blur."""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from heliograph.base.arrays import RCOND, TINY, Floats
from heliograph.base.errors import HeliographError
from heliograph.panel.place import Levels, grid, grown, homographies, is_possible, mapped, pitches, slopes

PIXEL_VARIANCE_PX2 = 1 / 12
"""Variance of a pixel's own width in squared px: that of an even light over it."""

REACH = 4.0
"""Standard deviations up to which an LED's image is taken: beyond is 1e-4 of its light."""

LEAST_BLUR_PX, MOST_BLUR = 0.3, 1.2
"""Least blur in px, and the most in pitches: narrower images fall between pixels, wider ones tell LEDs no longer."""

FIRST_BLUR = 0.35
"""First guess of the blur in pitches, from which 0.2 and 0.6 are reached."""

SLOPES = 9
"""What is fitted: eight coordinates of corners, and ln blur."""


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """What is known of a panel."""

    # rows, columns: lEDs along a column and along a row
    rows: int
    columns: int

    @property
    def grid(self) -> Floats:
        """(rows * columns, 2) places of the LEDs on the unit square."""
        return grid(self.rows, self.columns)

    def pitch(self, corners: Floats) -> float:
        """Shorter of the mean distances of neighbouring LEDs, in px."""
        return min(pitches(corners, self.rows, self.columns))

    def mask(self, corners: Floats, size: tuple[int, int]) -> Levels:
        """Pixels that count: 1 within the LED area and a little about it, 0 beyond. Returns (rows, columns)."""
        # pitches about the LED area that are looked at: what lies beyond a panel's rim is not known
        return mask_of(grown(corners, 0.6 * self.pitch(corners)), size)


class Fitted(NamedTuple):
    """A panel's place as fitted."""

    # (4, 2) corners in px of the picture
    corners: Floats
    # Standard deviation of an LED's image in px, without the pixel's width
    blur: float
    # Correlation of the pixels with the fitted image, -1 to 1
    score: float
    # (9, 9) power of the picture's change by corners and ln blur, for LEDs of the mean squared light 1; None where none
    # was needed
    hessian: Floats | None = None


class Lattice:
    """The LEDs of a panel at a place on a picture."""

    def __init__(self, shape: Shape, corners: Floats, blur: float, mask: Levels, factor: Floats | None = None):
        self.shape, self.corners = shape, corners
        self.sigma = float(np.hypot(blur, PIXEL_VARIANCE_PX2**0.5))
        self.points = np.ascontiguousarray(mapped(homographies(corners), shape.grid))
        self.mask = mask
        self.factor = self._factor() if factor is None else factor
        self._plane = plane(self.mask)
        self._on_leds = self._plane_on_leds()
        solved = self._solved(self._on_leds)
        # the plane's own power, less what the LEDs' images hold of it
        power = self._plane.reshape(3, -1).astype(np.float64) @ self._plane.reshape(3, -1).T
        self._rest, self._shared = power - self._on_leds.T @ solved, solved

    def gathered(self, images: Levels) -> Floats:
        """Inner products of images with each LED's image and its derivatives; see `kernels.gathered`."""
        from heliograph.panel import kernels  # Numba is slow to import

        out = np.empty((len(images), len(self.points), 4))
        for image, one in zip(images, out, strict=True):
            kernels.gathered(image, self.points, self.sigma, REACH * self.sigma, one)
        return out

    def drawn(self, amounts: Floats) -> Levels:
        """Image of LEDs within the mask; see `kernels.drawn`. Returns (rows, columns)."""
        from heliograph.panel import kernels

        out = np.zeros(self.mask.shape, np.float32)
        kernels.drawn(amounts, self.points, self.sigma, REACH * self.sigma, out)
        return np.asarray(out * self.mask)

    def light(self, images: Levels) -> tuple[Floats, Floats]:
        """Light of the LEDs and the background by least squares."""
        matched = self.gathered(images)[..., 0].T
        solved = self._solved(matched)
        onto = self._plane.reshape(3, -1) @ images.reshape(len(images), -1).T
        # A^T A a + A^T P c = A^T r and P^T A a + P^T P c = P^T r
        background = np.linalg.lstsq(self._rest, onto - self._on_leds.T @ solved, rcond=TINY)[0]
        return np.asarray(solved - self._shared @ background), np.asarray(background)

    def image(self, light: Floats, background: Floats) -> Levels:
        """Image of LEDs before a background, within the mask."""
        amounts = np.zeros((len(light), 4))
        amounts[:, 0] = light
        flat = np.tensordot(background.astype(np.float32), self._plane, 1)
        return np.asarray(self.drawn(amounts) + flat)

    def hessian(self, light: Floats) -> Floats:
        """Power of the image's change by corners and ln blur that no other light explains, (9, 9)."""
        moves = slopes(self.corners, self.shape.grid)
        amounts = np.zeros((SLOPES, len(light), 4))
        amounts[:-1, :, 1:3] = light[:, None] * moves
        amounts[-1, :, 3] = light
        changes = np.stack([self.drawn(one) for one in amounts])
        explained, background = self.light(changes)
        flat = changes.reshape(SLOPES, -1)
        onto = self._plane.reshape(3, -1) @ flat.T
        return np.asarray(
            flat.astype(np.float64) @ flat.T - self.gathered(changes)[..., 0] @ explained - onto.T @ background
        )

    def gradient(self, rest: Levels, light: Floats) -> Floats:
        """Inner products (9,) of what is left of a picture with its change by corners and ln blur."""
        seen = self.gathered(rest[None])[0]
        moves = slopes(self.corners, self.shape.grid)
        return np.append(np.einsum("n,knc,nc->k", light, moves, seen[:, 1:3]), light @ seen[:, 3])

    def _plane_on_leds(self) -> Floats:
        """A^T P, (n, 3): the plane at each LED, but for LEDs at the picture's edge, of which a part lies beyond."""
        size = np.array(self.mask.shape[::-1])
        # standard deviations from the picture's edge from which on an LED's image lies within it: 1 % of its light may
        # not
        if (np.abs(self.points - (size - 1) / 2) <= (size - 1) / 2 - 2.5 * self.sigma).all():
            return np.column_stack([np.ones(len(self.points)), self.points / np.maximum(size - 1, 1) - 0.5])
        return self.gathered(self._plane)[..., 0].T

    def _factor(self) -> Floats:
        """Cholesky factor of A^T A, a band (overlapping, n)."""
        rows, columns = self.shape.rows, self.shape.columns
        places = self.points.reshape(rows, columns, 2)
        # the nearest that two LEDs are, along rows and along columns
        near = [np.linalg.norm(np.diff(places, axis=k), axis=-1).min(initial=np.inf) for k in (0, 1)]
        # Least overlap of two LEDs' images that counts, as a fraction of that of one with itself. A tolerance
        far = 2 * self.sigma * np.sqrt(-np.log(1e-5))
        reach = [int(far / max(one, TINY)) for one in near]
        down, across = min(reach[0], rows - 1), min(reach[1], columns - 1)
        band = np.zeros((down * columns + across + 1, rows * columns))
        for u in range(down + 1):
            for v in range(-across if u else 0, across + 1):
                first = places[: rows - u, max(-v, 0) : columns - max(v, 0)]
                other = places[u:, max(v, 0) : columns + min(v, 0)]
                overlap = np.zeros((rows, columns))
                square = ((other - first) ** 2).sum(axis=-1)
                overlap[: rows - u, max(-v, 0) : columns - max(v, 0)] = np.exp(-square / (4 * self.sigma**2))
                band[u * columns + v] += overlap.ravel()
        # Added to the overlap of an LED with itself, as a fraction of it: LEDs that are alike share their light then.
        # It bounds by how much undoing the blur can multiply noise. Of panels with 1.4 to 4 standard deviations of blur
        # a pitch 1e-4 left the fewest bits wrong, 1e-2 up to twice as many, 1e-1 ten times as many
        band[0] += 1e-4
        try:
            return np.asarray(cholesky_banded(band / (4 * np.pi * self.sigma**2), lower=True, check_finite=False))
        except np.linalg.LinAlgError:
            raise HeliographError(
                f"the LEDs lie {self.shape.pitch(self.corners):.1f} px apart, too close for a blur of "
                f"{self.sigma:.1f} px: give corners and blur that locate finds"
            ) from None

    def _solved(self, right: Floats) -> Floats:
        return np.asarray(cho_solve_banded((self.factor, True), right, check_finite=False))


def mask_of(corners: Floats, size: tuple[int, int]) -> Levels:
    """1 within a quadrilateral, 0 beyond it. Returns (rows, columns)."""
    mask = np.zeros(size, np.uint8)
    cv2.fillConvexPoly(mask, np.rint(corners * 16).astype(np.int32), 1, shift=4)
    return mask.astype(np.float32)


def plane(mask: Levels) -> Levels:
    """Images whose combinations are an even background with a slope, within a mask."""
    rows, columns = mask.shape
    x, y = np.linspace(-0.5, 0.5, columns, dtype=np.float32), np.linspace(-0.5, 0.5, rows, dtype=np.float32)
    return np.stack([mask, mask * x, mask * y[:, None]])


STEPS = 12
"""Most steps of a fit. Chosen: it bounds the time of what does not converge."""

LONGEST_STEP = 0.3
"""Longest step of a corner in pitches, and of ln blur: farther the image is not linear in it."""

SAME_SIZE_PX, SAME_BLUR = 0.1, 1e-3
"""Change of a corner in px and of ln blur within which the overlap of LEDs is not computed again.

A side of 100 px then changes by 1e-3 of itself, as sigma does. With the overlap of a blur 1 % wider a fit did not end.
"""


# Step of a corner in px that ends a fit. A tolerance: it moves an LED's peak by 1e-4 of itself
def fitted(image: Levels, start: Fitted, shape: Shape, steps: int = STEPS, enough_px: float = 0.01) -> Fitted:
    """Fit a panel's corners and blur to a picture whatever its LEDs show, by Gauss-Newton."""
    mask = shape.mask(start.corners, (image.shape[0], image.shape[1]))
    best = _Seen(image, mask, start, shape)
    hessian = start.hessian if start.hessian is not None else best.hessian()
    fresh = start.hessian is None
    change = _change(hessian, best.gradient, LONGEST_STEP * shape.pitch(start.corners))
    for _ in range(steps):
        # Step of ln blur that ends a fit. A tolerance: it changes an LED's peak by 0.6 %
        if np.abs(change[:-1]).max() < enough_px and abs(change[-1]) < 3e-3:
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
    # added to each change's power, as a fraction of it: what the picture does not show stays as it is
    held = np.diag(np.diag(hessian)) * 1e-3
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
