"""Images of a panel's LEDs: light by least squares, and the fit of corners and blur."""

from typing import NamedTuple

import cv2
import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from heliograph.base.arrays import RCOND, TINY, Floats
from heliograph.base.errors import HeliographError
from heliograph.panel import kernels
from heliograph.panel.place import Levels, Shape, corner_jacobian, grow, homographies, transform

REACH = 4.0  # radius of an LED's image in standard deviations: 1e-4 of the light is beyond


FIRST_BLUR = 0.35  # initial blur of a fit in pitches: converges to 0.2 and to 0.6

MIN_BLUR_PX, MAX_BLUR = 0.3, 1.2
"""Minimum blur in px, and maximum blur in pitches."""


class Fit(NamedTuple):
    """Fitted position of a panel."""

    # (4, 2) corners in px of the picture
    corners: Floats
    # Standard deviation of an LED's image in px, pixel width excluded
    blur: float
    # Correlation of the pixels with the fitted image, -1 to 1
    score: float
    # (9, 9) power of the image's derivatives by corners and ln blur, for LEDs of mean squared light 1; None if unknown
    hessian: Floats | None = None


class Lattice:
    """Images A of the LEDs of a panel at a position, and a sloped background P."""

    def __init__(self, shape: Shape, corners: Floats, blur: float, mask: Levels, factor: Floats | None = None):
        self.shape, self.corners, self.mask = shape, corners, mask
        # uniform light over a pixel has the variance 1/12
        self.sigma = float(np.hypot(blur, (1 / 12) ** 0.5))
        self.points = np.ascontiguousarray(transform(homographies(corners), shape.grid))
        self.factor = self._factor() if factor is None else factor
        self._plane = plane(mask)
        self._on_leds = self._plane_on_leds()
        self._shared = self._solve(self._on_leds)
        # power of the plane outside the images of the LEDs
        flat = self._plane.reshape(3, -1)
        self._rest = flat.astype(np.float64) @ flat.T - self._on_leds.T @ self._shared

    def project(self, images: Levels) -> Floats:
        """Return the inner products of images with the images of LEDs and derivatives; see `kernels.project`."""
        out = np.empty((len(images), len(self.points), 4))
        for image, products in zip(images, out, strict=True):
            kernels.project(image, self.points, self.sigma, REACH * self.sigma, products)
        return out

    def render(self, amounts: Floats) -> Levels:
        """Render LEDs within the mask, (rows, columns); see `kernels.render`."""
        out = np.zeros(self.mask.shape, np.float32)
        kernels.render(amounts, self.points, self.sigma, REACH * self.sigma, out)
        return np.asarray(out * self.mask)

    def light(self, images: Levels) -> tuple[Floats, Floats]:
        """Estimate light and background of images by least squares."""
        solved = self._solve(self.project(images)[..., 0].T)
        onto = self._plane.reshape(3, -1) @ images.reshape(len(images), -1).T
        # A^T A a + A^T P c = A^T r and P^T A a + P^T P c = P^T r
        background = np.linalg.lstsq(self._rest, onto - self._on_leds.T @ solved, rcond=TINY)[0]
        return np.asarray(solved - self._shared @ background), np.asarray(background)

    def image(self, light: Floats, background: Floats) -> Levels:
        """Render LEDs on a background, within the mask."""
        amounts = np.pad(light[:, None], ((0, 0), (0, 3)))
        return np.asarray(self.render(amounts) + np.tensordot(background.astype(np.float32), self._plane, 1))

    def hessian(self, light: Floats) -> Floats:
        """Return the power (9, 9) of the derivatives by corners and ln blur that no other light explains."""
        amounts = np.zeros((9, len(light), 4))
        amounts[:-1, :, 1:3] = light[:, None] * corner_jacobian(self.corners, self.shape.grid)
        amounts[-1, :, 3] = light
        changes = np.stack([self.render(amount) for amount in amounts])
        explained, background = self.light(changes)
        flat = changes.reshape(9, -1)
        onto = self._plane.reshape(3, -1) @ flat.T
        power = flat.astype(np.float64) @ flat.T
        return np.asarray(power - self.project(changes)[..., 0] @ explained - onto.T @ background)

    def gradient(self, rest: Levels, light: Floats) -> Floats:
        """Return the inner products (9,) of a residual with the derivatives by corners and ln blur."""
        products = self.project(rest[None])[0]
        jacobian = corner_jacobian(self.corners, self.shape.grid)
        return np.append(np.einsum("n,knc,nc->k", light, jacobian, products[:, 1:3]), light @ products[:, 3])

    def _plane_on_leds(self) -> Floats:
        """Return A^T P, (n, 3): the plane at each LED, or inner products near the picture's edge."""
        size = np.array(self.mask.shape[::-1])
        if (np.abs(self.points - (size - 1) / 2) <= (size - 1) / 2 - 2.5 * self.sigma).all():
            return np.column_stack([np.ones(len(self.points)), self.points / np.maximum(size - 1, 1) - 0.5])
        return self.project(self._plane)[..., 0].T

    def _factor(self) -> Floats:
        """Return the banded Cholesky factor of A^T A."""
        rows, columns = self.shape.rows, self.shape.columns
        places = self.points.reshape(rows, columns, 2)
        # overlaps below 1e-5 are neglected, by the smallest distances along rows and columns
        far = 2 * self.sigma * np.sqrt(-np.log(1e-5))
        near = [np.linalg.norm(np.diff(places, axis=k), axis=-1).min(initial=np.inf) for k in (0, 1)]
        down, across = (min(int(far / max(d, TINY)), n - 1) for d, n in zip(near, (rows, columns), strict=True))
        band = np.zeros((down * columns + across + 1, rows * columns))
        for u in range(down + 1):
            for v in range(-across if u else 0, across + 1):
                first = np.s_[: rows - u, max(-v, 0) : columns - max(v, 0)]
                square = ((places[u:, max(v, 0) : columns + min(v, 0)] - places[first]) ** 2).sum(axis=-1)
                overlap = np.zeros((rows, columns))
                overlap[first] = np.exp(-square / (4 * self.sigma**2))
                band[u * columns + v] += overlap.ravel()
        # limits the amplification of noise: for 1.4 to 4 standard deviations of blur per pitch, 1e-4 left the fewest
        # bit errors, 1e-2 up to twice as many
        band[0] += 1e-4
        try:
            return np.asarray(cholesky_banded(band / (4 * np.pi * self.sigma**2), lower=True, check_finite=False))
        except np.linalg.LinAlgError:
            raise HeliographError(
                f"the LEDs lie {self.shape.pitch(self.corners):.1f} px apart, too close for a blur of "
                f"{self.sigma:.1f} px: give corners and blur that locate finds"
            ) from None

    def _solve(self, right: Floats) -> Floats:
        return np.asarray(cho_solve_banded((self.factor, True), right, check_finite=False))


def mask_of(corners: Floats, size: tuple[int, ...], margin: float) -> Levels:
    """Return a mask (rows, columns): 1 within a quadrilateral and a margin in px."""
    mask = np.zeros(size, np.uint8)
    cv2.fillConvexPoly(mask, np.rint(grow(corners, margin) * 16).astype(np.int32), 1, shift=4)
    return mask.astype(np.float32)


def plane(mask: Levels) -> Levels:
    """Return the images (3, rows, columns) of a constant and of slopes along x and y, within a mask."""
    y, x = (np.linspace(-0.5, 0.5, n, dtype=np.float32) for n in mask.shape)
    return np.stack([mask, mask * x, mask * y[:, None]])


def fit(image: Levels, start: Fit, shape: Shape, steps: int = 12) -> Fit:
    """Fit a panel's corners and blur to a picture with any content, by Gauss-Newton."""
    mask = mask_of(start.corners, image.shape, 0.6 * shape.pitch(start.corners))
    best = _Residual(image, mask, start, shape)
    hessian, is_fresh = start.hessian, start.hessian is None
    if hessian is None:
        hessian = best.hessian()
    change = _step(hessian, best, shape)
    for _ in range(steps):
        move_px, scale = float(np.abs(change[:-1]).max()), abs(float(change[-1]))
        # 1e-4 and 0.6 % of an LED's peak
        if move_px < 0.01 and scale < 3e-3:
            break
        # the overlap of LEDs is the same
        is_same = move_px < 0.1 and scale < 1e-3
        moved = _move(best.fit, change, shape)
        if not shape.is_possible(moved.corners):
            break
        try:
            trial = _Residual(image, mask, moved, shape, best.lattice.factor if is_same else None)
        except HeliographError:  # too much blur for the pitch
            break
        if trial.fit.score >= best.fit.score:
            best = trial
            hessian = best.hessian() if is_fresh else hessian
        elif is_fresh:
            change = change / 2
            continue
        elif move_px < 0.1:
            break
        else:  # the Hessian of another picture misled
            hessian, is_fresh = best.hessian(), True
        change = _step(hessian, best, shape)
    return best.fit._replace(hessian=hessian)


class _Residual:
    """Residual of a picture for a position of a panel."""

    def __init__(self, image: Levels, mask: Levels, at: Fit, shape: Shape, factor: Floats | None = None):
        self.lattice = Lattice(shape, at.corners, at.blur, mask, factor)
        masked = image * mask
        light, background = self.lattice.light(masked[None])
        self._light = light[:, 0]
        self._rest = masked - self.lattice.image(self._light, background[:, 0])
        self._power = max(float(self._light @ self._light) / len(self._light), TINY)
        # correlation of the pixels with the fitted image
        pixels = image[mask > 0].astype(np.float64)
        total = float(((pixels - pixels.mean()) ** 2).sum()) if pixels.size else 0.0
        residual = float((self._rest[mask > 0].astype(np.float64) ** 2).sum())
        self.fit = at._replace(score=float(np.sqrt(max(1 - residual / max(total, TINY), 0.0))))

    def gradient(self) -> Floats:
        """Return the gradient (9,) of the explained power, for LEDs of mean squared light 1."""
        return self.lattice.gradient(self._rest, self._light) / self._power

    def hessian(self) -> Floats:
        """Return the Hessian (9, 9) of the explained power."""
        return self.lattice.hessian(self._light) / self._power


def _step(hessian: Floats, residual: _Residual, shape: Shape) -> Floats:
    """Return the limited Gauss-Newton step (9,) of corners and ln sigma."""
    change = np.linalg.lstsq(hessian + np.diag(np.diag(hessian)) * 1e-3, residual.gradient(), rcond=RCOND)[0]
    # the image is nearly linear within 0.3 pitches, and 0.3 of ln blur
    longest = 0.3 * np.append(np.full(8, shape.pitch(residual.fit.corners)), 1.0)
    return np.asarray(change / max(np.abs(change / longest).max(), 1.0))


def _move(at: Fit, change: Floats, shape: Shape) -> Fit:
    """Apply a step of corners and ln sigma; sigma includes the pixel width."""
    variance = (at.blur**2 + 1 / 12) * np.exp(2 * change[-1]) - 1 / 12
    limit = max(MAX_BLUR * shape.pitch(at.corners), MIN_BLUR_PX)
    blur = float(np.clip(np.sqrt(max(variance, 0.0)), MIN_BLUR_PX, limit))
    return at._replace(corners=at.corners + change[:-1].reshape(4, 2), blur=blur)
