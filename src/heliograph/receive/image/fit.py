"""Fit of the array's image to pixels: position, pitch, rotation and blur to a hundredth of a pixel."""

from dataclasses import dataclass

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.image.pose import Pose
from heliograph.receive.image.robust import correlation, robust_std
from heliograph.receive.image.window import PlacedPixels, cut_out, plane, window_around

BIWEIGHT = 4.685
"""Standard deviations from which on a residual has no weight: Tukey's biweight of 95 % efficiency."""

PANEL_MARGINS = (0.75, 2.0)
"""Rims in pitches of two squares around the LEDs; their combination stands for a panel of unknown width and gray."""

FIT_LOADING = 1e-9
"""Relative loading of the normal equations' diagonal: keeps a parameter that no pixel shows solvable."""

FIRST_LOADING = 1e-6
"""The same of the first coefficients, where images of the array and of a plane may be alike."""

LEAST_INFORMATION = 1e-3
"""Added to the diagonal before it is loaded: of images that are 0 all over something must be left to solve for."""

LEAST_RESIDUAL = 0.5
"""Least standard deviation of residuals in gray levels by which they are weighed: the largest error of rounding."""

LEAST_VARIANCE = 0.08
"""Least variance of a pixel in squared gray levels: that of rounding to whole levels, 1/12."""

HELD_GAIN = 1e3
"""Weight of an expected gain in the first coefficients, over that of the pixels: it all but holds the gain.

The pixels can move it by a thousandth of the way to what they say.
"""

CLOSE_PX, CLOSE_BLUR, CLOSE_GAIN = 0.02, 0.02, 0.1
"""Steps of the array's rim in px, of ln blur, and of the gain as a fraction of it, below which a fit ends.

The next steps are a tenth of these, so what is left is below the error that noise gives a sum at 80 m (0.004 px rms).
While the gain is wrong all steps are too short or too long, so a fit goes on until it is right.
"""

LONGEST_PX = 0.8
"""Longest step of the centre in px, half a pitch where that is more: the width of an edge of the array."""

LONGEST = (0.1, 0.05, 0.2, 0.05, 0.05)
"""Longest steps of ln pitch, roll, ln blur, stretch and shear: they move the rim of 16 LEDs by half a pitch or so."""

AMPLITUDE_MARGIN_PX = 1.0
"""Pixels beyond the array in which a header's amplitude is measured.

More of them add background, fewer lose its rim.
"""

EXPECTED_GAIN_SPREAD = 0.5
"""Standard deviation of an expected gain, as a fraction of it: before a bright sky the rim of a dark panel adds half.

With 0.15 the gain was held below what the pixels showed. The sum's blur grew in its place, until the array was lost: 4
of 40 packets of the high layer in the strongest bumps of a recorded drive, none with 0.5.
"""


@dataclass(frozen=True, slots=True)
class Fit:
    """The array's image found in pixels.

    Attributes
    ----------
    vector
        (x, y, ln pitch, roll, ln blur) of the pose, (5,), or with the tilt, (7,), as the prior.
    covariance
        Posterior covariance of what was fitted, (5, 5) or (7, 7).
    gain
        Gray levels of the unresolved array with all weights 1.
    score
        Correlation of pixels and fitted image, -1 to 1; after a small last step, of the image before that step.
    """

    vector: Floats
    covariance: Floats
    gain: float
    score: float

    @property
    def pose(self) -> Pose:
        """The pose."""
        return Pose.from_vector(self.vector)


@dataclass(frozen=True, slots=True)
class Prior:
    """What is expected before a fit.

    Attributes
    ----------
    vector
        Pose vector, (5,) or, with the tilt, (7,); the fit starts there.
    covariance
        Its covariance, (5, 5) or (7, 7); with (5, 5) the tilt is held.
    gain
        Expected gain in gray levels, or 0 where it is unknown.
    """

    vector: Floats
    covariance: Floats
    gain: float = 0.0


def fit_array(
    image: Floats,
    corner: tuple[int, int],
    prior: Prior,
    weights: Floats,
    iterations: int,
    panel: bool = False,
    start: Floats | None = None,
    resolved: bool = True,
    open_pixels: Floats | None = None,
    smear: tuple[float, float] = (0.0, 0.0),
) -> Fit:
    """Most probable pose of LEDs of known luminances, by Gauss-Newton with robust weights.

    Parameters
    ----------
    image
        (rows, columns) gray levels: gain * array(pose) + a plane of background + noise.
    corner
        (x, y) on the sensor of ``image[0, 0]``, in px.
    prior
        Pose expected, with its covariance, and the gain expected.
    weights
        (n, n) luminance of each LED: 1 for all on, +-1 for a header less its inverse.
    iterations
        Most Gauss-Newton steps, 1 or more.
    panel
        Whether a panel darker or brighter than the background may surround the LEDs: it does in a sum of frames, and
        cancels in a difference.
    start
        Pose vector to start from, (5,) or (7,) as the prior's; None starts at the prior.
    resolved
        Whether LEDs may show singly. If not, the array is an even square with all LEDs on, which is faster.
    open_pixels
        (rows, columns) 1 for pixels that count, 0 for those that something hides; None if all count.
    smear
        Standard deviations in px along x and y of the array's motion while the image was taken.

    Returns
    -------
    Pose, its covariance, gain and score.

    Raises
    ------
    numpy.linalg.LinAlgError
        The pixels give no pose, as numbers that are not finite do.
    """
    free = len(prior.covariance)
    scene = _Scene(image, corner, weights, panel, resolved, free, open_pixels, smear)
    vector, precision = (prior.vector if start is None else start).copy(), np.linalg.inv(prior.covariance)
    scene.place(vector)
    linear = scene.coefficients(prior.gain)
    for _ in range(iterations):
        matrix, rhs = scene.equations(linear)
        # (J^T W J + P^-1) step = J^T W r + P^-1 (theta_0 - theta), and the same for the gain
        matrix[:free, :free] += precision
        rhs[:free] += precision @ (prior.vector - vector)[:free]
        if prior.gain:
            weight = (EXPECTED_GAIN_SPREAD * prior.gain) ** -2
            matrix[free, free] += weight
            rhs[free] += weight * (prior.gain - linear[0])
        step = np.asarray(np.linalg.solve(_loaded(matrix, FIT_LOADING), rhs), np.float64)
        if not np.isfinite(step).all():
            raise np.linalg.LinAlgError("the fit of an array's pose has no solution")
        limit = _step_limits(vector)[:free]
        vector[:free] += np.clip(step[:free], -limit, limit)
        linear = linear + step[free:]
        near = _rim_px(step[:free], vector, len(weights)) < CLOSE_PX and abs(step[4]) < CLOSE_BLUR
        # pitch and blur of a header, from which distances are measured, go on in small steps
        if panel and near and abs(step[free]) < CLOSE_GAIN * abs(linear[0]):
            break
        scene.place(vector)
    covariance = np.linalg.inv(_loaded(matrix, FIT_LOADING))[:free, :free]
    return Fit(
        vector,
        np.asarray(covariance, np.float64),
        float(linear[0]),
        scene.score(linear),
    )


class _Scene:
    """The images whose combination is the pixels, at a pose."""

    def __init__(
        self,
        image: Floats,
        corner: tuple[int, int],
        weights: Floats,
        panel: bool,
        resolved: bool,
        free: int,
        open_pixels: Floats | None,
        smear: tuple[float, float],
    ):
        from heliograph.receive.image import kernels  # Numba is slow to import

        self._kernels, self._image, self._corner, self._weights = kernels, image, corner, weights
        self._resolved, self._smear = resolved, smear
        self._margins = PANEL_MARGINS if panel else ()
        shaped = 1 + len(self._margins)
        self._shapes = np.empty((shaped, 1 + free, *image.shape))
        self._plane = plane(*image.shape)
        self._open = open_pixels
        if open_pixels is not None:
            # a pixel that is 0 in all images says nothing
            self._image, self._plane = image * open_pixels, self._plane * open_pixels
        self._residual = np.empty(image.shape)

    def place(self, vector: Floats) -> None:
        """Work the images out at a pose."""
        x0, y0 = float(self._corner[0]), float(self._corner[1])
        half = 0.5 * self._weights.shape[0]
        if self._resolved:
            self._kernels.render(vector, self._weights, x0, y0, self._shapes[0], *self._smear)
        else:
            self._kernels.render_box(vector, half, x0, y0, self._shapes[0], *self._smear)
        for shape, margin in zip(self._shapes[1:], self._margins, strict=True):
            self._kernels.render_box(vector, half + margin, x0, y0, shape, *self._smear)
        if self._open is not None:
            self._shapes *= self._open

    def coefficients(self, gain: float) -> Floats:
        """Least squares coefficients of the images, near an expected gain if there is one."""
        columns = np.concatenate([self._shapes[:, 0], self._plane])
        a = columns.reshape(len(columns), -1)
        matrix, rhs = a @ a.T, a @ self._image.ravel()
        if gain:
            weight = HELD_GAIN * matrix[0, 0]
            matrix[0, 0] += weight
            rhs[0] += weight * gain
        return np.asarray(np.linalg.solve(_loaded(matrix, FIRST_LOADING), rhs))

    def equations(self, linear: Floats) -> tuple[Floats, Floats]:
        """Normal equations of steps in pose and coefficients, divided by the noise variance of the residuals."""
        size = self._shapes.shape[1] - 1 + len(linear)
        matrix, rhs = np.empty((size, size)), np.empty(size)
        rough = BIWEIGHT * _noise_of(self._counting(self.residual(linear)))
        mass, loss = self._kernels.normal_equations(self._image, self._shapes, self._plane, linear, rough, matrix, rhs)
        mass -= 0.0 if self._open is None else float((self._open == 0).sum())
        noise = max(loss / max(mass - size, 1.0), LEAST_VARIANCE)
        return matrix / noise, rhs / noise

    def score(self, linear: Floats) -> float:
        """Correlation of pixels and images."""
        image = self._counting(self._image)
        return correlation(image, image - self._counting(self.residual(linear)))

    def _counting(self, image: Floats) -> Floats:
        """Pixels that count."""
        return image if self._open is None else image[self._open > 0]

    def residual(self, linear: Floats) -> Floats:
        """Pixels less the images, (rows, columns); overwritten by the next call."""
        self._kernels.residuals(self._image, self._shapes, self._plane, linear, self._residual)
        return self._residual


def _noise_of(residual: Floats) -> float:
    """Standard deviation of residuals, at least `LEAST_RESIDUAL`."""
    return max(robust_std(residual), LEAST_RESIDUAL)


def _loaded(matrix: Floats, loading: float) -> Floats:
    """M + lambda (diag M + epsilon 1)."""
    return matrix + loading * np.diag(np.diag(matrix) + LEAST_INFORMATION)


def _step_limits(vector: Floats) -> Floats:
    """Longest steps (7,) within which the image is about linear in the pose."""
    reach = max(LONGEST_PX, 0.5 * float(np.exp(vector[2])))
    return np.array([reach, reach, *LONGEST])


def _rim_px(step: Floats, vector: Floats, side: int) -> float:
    """How far a step moves the rim of an array."""
    half = 0.5 * side * float(np.exp(vector[2]))
    return float(np.abs(step[:2]).max() + half * np.abs(step[[2, 3, *range(5, len(step))]]).max())


def header_amplitude(frame: PlacedPixels, pose: Pose, weights: Floats) -> float:
    """Amplitude with which a frame shows a pattern.

    Parameters
    ----------
    frame
        Frame in which the array is; what lies beyond it repeats its border.
    pose
        Pose of the array's image on the sensor.
    weights
        (n, n) luminances of the pattern less its inverse, +-1 with mean 0; 0 for LEDs that are left out.

    Returns
    -------
    Least squares amplitude in gray levels; positive where the frame shows the pattern, negative for its inverse.
    """
    from heliograph.receive.image import kernels

    window = window_around(pose, weights.shape[0], AMPLITUDE_MARGIN_PX)
    cut = cut_out(frame, window)
    model = np.empty((6, *cut.shape))
    kernels.render(pose.full_vector(), weights, float(window[0]), float(window[1]), model)
    shape = model[0] - model[0].mean()
    return float((cut * shape).sum() / max((shape * shape).sum(), TINY))
