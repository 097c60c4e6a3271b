"""Data without inverses: an array followed by what is decided of the data in every other frame.

A frame shows r = g A x + b + n. At the pose predicted, its cells are equalised; those beyond doubt are taken as known.
Their light, that of the levels' mean and what is behind the array have an image whose fit gives the pose, the light of
the undecided cells being noise of known colour: so what is guessed at a wrong pose does not confirm that pose.
"""

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive import kernels as images
from heliograph.receive.fit import Fit, correlation
from heliograph.receive.kalman import RATES, SHOWN, STATES, PoseState, View
from heliograph.receive.pose import Pose
from heliograph.receive.soft import kernels
from heliograph.receive.soft.behind import COUNT, Header, images_behind, learn_behind, surroundings
from heliograph.receive.soft.equalise import equalise, products
from heliograph.receive.soft.glance import Glance, take_glance, to_grid, within
from heliograph.receive.soft.look import Look, weigh
from heliograph.receive.soft.noise import Noise, measure_noise
from heliograph.receive.soft.threads import one_thread
from heliograph.receive.track import TrackedPair, Tracker

Floats = NDArray[np.float64]

DECIDED = View(np.eye(SHOWN, STATES), np.array([0.01, 0.01, 0.002, 0.001, 0.02]) ** 2)
"""What a frame of decided data shows; the errors are those of the images' model."""

SURE = 0.97
"""Mean of a cell, in magnitude, from which on it is decided."""

GAIN_SPREAD = 0.01
"""Standard deviation of a frame's gain, as a share of it."""

BEHIND_SPREAD = 5.0
"""Standard deviation in gray levels by which what is behind the array may differ from what it was."""

FRESH = 0.2
"""Share of a pair in what is known to be behind the array."""


class Singles:
    """Follows an array through the data of a packet without inverses.

    Parameters
    ----------
    late_s
        By how much the light of the levels' mean, and that of the data, comes after the middle of an exposure.
    headers
        Header pairs of the packet, at least one; they tell noise and background.
    gain
        Gray levels of a wide array with all LEDs on.
    shares
        (n, n) share of its light that each LED gives.

    Attributes
    ----------
    noise
        Of glances, as the headers tell it.
    glances
        What the two frames followed last show.
    """

    def __init__(self, late_s: tuple[float, float], headers: list[Header], gain: float, shares: Floats):
        self._side, self._late_s, self._gain, self._shares = len(shares), late_s, gain, shares
        self._half, self._behind, left = learn_behind(headers, gain, shares)
        # what motion leaves of headers is no random data's and alike in successive sums: with gain 0 none is taken off
        seen = measure_noise([take_glance(*header, self._side) for header in headers], 0.0, self._side, shares)
        # a glance of a single frame is twice the frame: twice the variance of a difference of two
        self.noise = Noise(2 * seen.lit, max(2 * seen.dark, 4 * left))
        self.glances: tuple[Glance, ...] = ()

    @one_thread()
    def follow(self, first: Frame, second: Frame, tracker: Tracker) -> TrackedPair:
        """Find the array in two frames and move the filter on; what they show of the data becomes `glances`."""
        before, behind = tracker.state, self._behind
        # the first frame would take as long again, and as many bits are wrong with it as without
        fit = self._step(second, tracker)
        seen = tracker.sees(first, second, fit)
        if seen:
            tracker.last_seen_s = tracker.state.time_s
        else:
            # what passes before the array is not behind it
            tracker.state, self._behind = before, behind
            tracker.state = tracker.predict(second.time_s)
        # the earlier pose too is known better now
        self.glances = tuple(self._glance(frame, tracker.state) for frame in (first, second))
        return TrackedPair(tracker.state, fit, seen)

    def _step(self, frame: Frame, tracker: Tracker) -> Fit:
        """Find the array in a frame."""
        state = tracker.predict(frame.time_s)
        fit = self._fit(frame, state)
        tracker.state = state.condition(fit.vector[:SHOWN], fit.covariance, DECIDED)
        return fit

    def _glance(self, frame: Frame, state: PoseState) -> Glance:
        """A frame less what is behind the array, the array where `state` has it."""
        # what is behind shines all through the exposure
        middle = state.pose_at(frame.time_s)
        still, data = (state.pose_at(frame.time_s + late_s) for late_s in self._late_s)
        corner, image = surroundings(frame, middle, self._side)
        behind = images_behind(middle, corner, image.shape, self._half)[:, 0]
        above = image - np.tensordot(self._behind, behind, 1)
        return _glance_of(frame, above, corner, data, still)

    def _fit(self, frame: Frame, state: PoseState) -> Fit:
        """Most probable pose, gain and background.

        One Gauss-Newton step from what was expected, with covariance P: (P^-1 + D^T C^-1 D)^-1 D^T C^-1 e, with e, D
        and C as in `_equations`. A frame's prediction is near enough that a second changes nothing.
        """
        expected, covariance = state.expected(DECIDED)
        start = np.concatenate([expected, [self._gain], self._behind])
        precision = np.zeros((start.size, start.size))
        precision[:SHOWN, :SHOWN] = np.linalg.inv(covariance)
        spreads = np.append(GAIN_SPREAD * self._gain, np.full(COUNT, BEHIND_SPREAD))
        precision[range(SHOWN, start.size), range(SHOWN, start.size)] = spreads**-2
        matrix, rhs, score = self._equations(frame, state, start)
        found = start + np.linalg.solve(matrix + precision, rhs)
        self._behind = self._behind + FRESH * (found[SHOWN + 1 :] - self._behind)
        after = np.asarray(np.linalg.inv(matrix + precision)[:SHOWN, :SHOWN], np.float64)
        vector = np.append(found[:SHOWN], state.tilt.mean)
        return Fit(vector, after, float(found[SHOWN]), score)

    def _equations(self, frame: Frame, state: PoseState, at: Floats) -> tuple[Floats, Floats, float]:
        """D^T C^-1 D, D^T C^-1 e and the correlation of frame and image; `state` gives rates and tilt, which are held.

        e is twice what is left of the frame by the image of all that is known, D the image's derivatives and C = g^2 B
        B^T + s^2 the noise, the light of the undecided cells included.
        """
        middle, gain = Pose.of(np.append(at[:SHOWN], state.tilt.mean)), float(at[SHOWN])
        still, data = (middle.moved(*(late_s * state.mean[RATES][:2])) for late_s in self._late_s)
        corner, image = surroundings(frame, middle, self._side)
        behind = images_behind(middle, corner, image.shape, self._half)
        above = image - np.tensordot(at[SHOWN + 1 :], behind[:, 0], 1)
        weighted = weigh(_glance_of(frame, above, corner, data, still), self.noise, self._side, self._shares)
        look = weighted.look()
        known, unknown = self._decided(look, gain)
        lit = self._images(known, still, data, corner, image.shape)
        slopes = gain * lit[1:] + np.tensordot(at[SHOWN + 1 :], behind[:, 1:], 1)
        left = weighted.change - 2 * gain * weighted.root * lit[0]
        columns = 2 * weighted.root * np.concatenate([slopes, lit[:1], behind[:, 0]])
        every = np.concatenate([columns, left[None]])
        part = products(weighted, look, every, unknown, gain**2 / self.noise.lit) / self.noise.lit
        score = correlation(weighted.change, weighted.root * 2 * gain * lit[0])
        return part[:-1, :-1], part[:-1, -1], score

    def _decided(self, look: Look, gain: float) -> tuple[Floats, NDArray[np.intp]]:
        """Means of the cells, 0 where they are not decided, and which those are."""
        size = self._side**2
        # L = 2 G: the others taken as Gaussian, which decides fewer of them
        mean = np.tanh(equalise(look, gain, self.noise.lit, np.zeros(size), np.ones(size)).added[1])
        decided = np.abs(mean) > SURE
        return np.where(decided, mean, 0.0), np.flatnonzero(~decided)

    def _images(
        self, known: Floats, still: Pose, data: Pose, corner: tuple[int, int], shape: tuple[int, int]
    ) -> Floats:
        """Image of the known cells and of the levels' mean, and its derivatives by the pose, (6, rows, columns)."""
        x, y = float(corner[0]), float(corner[1])
        levels = to_grid(0.5 * kernels.leds(known))
        varied, mean = np.empty((6, *shape)), np.empty((6, *shape))
        images.render(data.full_vector(), levels * self._shares, x, y, varied)
        images.render(still.full_vector(), 0.5 * self._shares, x, y, mean)
        return np.asarray(varied + mean)


def _glance_of(frame: Frame, above: Floats, corner: tuple[int, int], data: Pose, still: Pose) -> Glance:
    """A glance of a single frame, by what it shows above the background."""
    return Glance(2 * above, 2 * above, corner, (data,), still, inside=within((frame,), corner, above.shape))
