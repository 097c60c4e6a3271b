"""Crosstalk between the colours of a panel: blind estimation and removal."""

from collections.abc import Iterator
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from heliograph.base.arrays import RCOND, TINY, Floats
from heliograph.base.errors import HeliographError, shown
from heliograph.panel.place import COLOURS, matrix_of

Bits = NDArray[np.bool_]

STATES = np.array(list(product((0.0, 1.0), repeat=COLOURS)))  # states (8, 3) of an LED with three colours


class UnmixedColours(NamedTuple):
    """Result of `unmix_colours`.

    Attributes
    ----------
    bits
        (..., 3) bool, True where an LED of that colour is on.
    light
        (..., 3) float64 light of each colour: about 0 if off, 1 if on.
    matrix
        (3, 3) float64 levels of each channel (row) for each lit colour (column).
    offset
        (3,) float64 levels of the channels with all colours off.
    """

    bits: Bits
    light: Floats
    matrix: Floats
    offset: Floats


def unmix_colours(values: Any, start: Any = None, full_scale: float | None = None) -> UnmixedColours:
    r"""Remove the crosstalk between the colours of a panel, without a calibration film.

    An LED with the bits x for the three colours has the values

        y = M x + b + noise,

    clipped at full scale. Decision-directed least squares estimate M and b: each LED gets the bits with the nearest
    M x + b, then M and b minimise the sum of \|y - M x - b\|^2 over all LEDs, until no bit changes. The start with
    the smallest sum wins. Channel k has the strongest response to colour k of the result, so channels in the order
    blue, green, red give bits in this order.

    Parameters
    ----------
    values
        (..., 3) numbers of any shape and real dtype, such as from `sample`; `numpy.stack` joins frames of a film. Each
        colour must be on in some LEDs and off in others, independently of the other colours.
    start
        (3, 3) initial M with any scale, such as the leakage of another film; None if unknown.
    full_scale
        Level of clipped values, such as 250 for frames of 8 bits; None if no value is clipped.

    Returns
    -------
    Bits, light after removal of crosstalk, M and b.

    Raises
    ------
    HeliographError
        The values have another shape, are not finite, or do not show three colours that change independently.

    Examples
    --------
    >>> import numpy as np, heliograph
    >>> rng = np.random.default_rng(0)
    >>> bits = rng.random((16, 16, 3)) < 0.5
    >>> crosstalk = np.array([[90, 40, 10], [20, 80, 45], [5, 30, 70]])
    >>> values = bits @ crosstalk.T + 12 + rng.normal(0, 4, bits.shape)
    >>> unmixed = heliograph.unmix_colours(values)
    >>> int((unmixed.bits != bits).sum())
    0
    """
    levels = _levels(values)
    flat = levels.reshape(-1, COLOURS)
    top = np.inf
    if full_scale is not None:
        top = float(matrix_of(full_scale, (), "full_scale is a level, such as 250"))
    guess = None
    if start is not None:
        rule = "start is a matrix (3, 3): the response of each channel (row) to each colour (column)"
        guess = matrix_of(start, (COLOURS, COLOURS), rule)
    rng = np.random.default_rng(0)
    few = flat if len(flat) <= 2000 else flat[rng.choice(len(flat), 2000, replace=False)]
    best: tuple[float, Floats] | None = None
    for mixing in _initial_mixings(few, guess, rng):
        cost, mixing = _alternate(few, mixing, top)
        if (best is None or cost < best[0] * (1 - RCOND)) and _is_separated(few, mixing, top):
            best = cost, mixing
    if best is None:
        raise HeliographError(
            "the values do not show three colours that change independently: give frames in which each colour is on in "
            "some LEDs and off in others, in all combinations"
        )
    _, mixing = _alternate(flat, best[1], top)
    mixing = _sort_colours(mixing)
    bits = _decide(flat, mixing, top)
    matrix, offset = mixing[:, :COLOURS], np.asarray(mixing[:, COLOURS], np.float64)
    light = np.linalg.solve(matrix, (flat - offset).T).T
    shape = levels.shape
    return UnmixedColours(bits.reshape(shape) > 0, np.asarray(light.reshape(shape), np.float64), matrix, offset)


def _alternate(levels: Floats, mixing: Floats, top: float) -> tuple[float, Floats]:
    """Alternate decisions and least squares; return the sum of squares and the mixing (3, 4)."""
    bits = _decide(levels, mixing, top)
    for _ in range(60):
        known = np.column_stack([bits, np.ones(len(bits))])
        # a clipped level may be higher
        aim = np.where(levels >= top, np.maximum(levels, known @ mixing.T), levels)
        mixing = np.linalg.lstsq(known, aim, rcond=RCOND)[0].T
        again = _decide(levels, mixing, top)
        if (again == bits).all():
            break
        bits = again
    return float((_residual(levels, mixing, bits, top) ** 2).sum()), mixing


def _decide(levels: Floats, mixing: Floats, top: float) -> Floats:
    """Return the bits (n, 3) as 0 and 1 with the nearest levels."""
    shown = np.minimum(STATES @ mixing[:, :COLOURS].T + mixing[:, COLOURS], top)
    distance = (shown**2).sum(axis=1) - 2 * np.minimum(levels, top) @ shown.T
    return np.asarray(STATES[distance.argmin(axis=1)])


def _residual(levels: Floats, mixing: Floats, bits: Floats, top: float) -> Floats:
    shown = bits @ mixing[:, :COLOURS].T + mixing[:, COLOURS]
    return np.asarray(np.minimum(levels, top) - np.minimum(shown, top))


def _is_separated(levels: Floats, mixing: Floats, top: float) -> bool:
    """Return True if each colour is on and off often enough, and no step between states is a split of noise."""
    bits = _decide(levels, mixing, top)
    on = bits.sum(axis=0)
    if min(on.min(), (len(bits) - on).min()) < 4:
        return False
    matrix = mixing[:, :COLOURS]
    known = np.column_stack([bits, np.ones(len(bits))])
    if np.linalg.matrix_rank(known) <= COLOURS or np.linalg.cond(matrix) > 1 / RCOND:
        return False
    # between two states, up to the sign
    differences = np.array([step for step in product((-1.0, 0.0, 1.0), repeat=COLOURS) if step > (0.0, 0.0, 0.0)])
    steps = matrix @ differences.T
    size = np.linalg.norm(steps, axis=0)
    along = _residual(levels, mixing, bits, top) @ (steps / size)
    return bool((size >= 3.3 * along.std(axis=0)).all())  # a split of noise has 2.7


def _initial_mixings(levels: Floats, guess: Floats | None, rng: np.random.Generator) -> Iterator[Floats]:
    """Yield initial mixings (3, 4): by the range of each channel, by the caller, and by the levels of three LEDs."""
    dark = levels[np.argsort(levels.sum(axis=1))[: max(1, len(levels) // 50)]].mean(axis=0)
    high = np.quantile(levels, 0.98, axis=0) - dark
    middle = 0.5 * (levels.min(axis=0) + levels.max(axis=0)) - dark
    guesses = [np.eye(COLOURS), *([guess] if guess is not None else [])]
    for matrix in guesses:
        for reach in (high, 2 * middle):
            yield np.column_stack([matrix / max(np.abs(matrix).max(), TINY) * reach[:, None], dark])
    far = levels - dark
    lit = far[(far**2).sum(axis=1) >= 0.1 * (far**2).sum(axis=1).max()]
    for _ in range(40):
        matrix = lit[rng.choice(len(lit), COLOURS, replace=len(lit) < COLOURS)].T
        yield np.column_stack([matrix, dark])


def _sort_colours(mixing: Floats) -> Floats:
    """Return the mixing (3, 4) with positive colours, in the order of the channels with the strongest response."""
    matrix, offset = mixing[:, :COLOURS].copy(), mixing[:, COLOURS].copy()
    for k in range(COLOURS):
        if matrix[:, k].sum() < 0:  # exchange off and on
            offset += matrix[:, k]
            matrix[:, k] *= -1
    share = matrix / np.linalg.norm(matrix, axis=1, keepdims=True)
    _, order = linear_sum_assignment(-share / np.linalg.norm(share, axis=0))
    return np.column_stack([matrix[:, order], offset])


def _levels(values: Any) -> Floats:
    try:
        found = np.asarray(values)
        levels = found.astype(np.float64) if found.dtype.kind in "buif" else None
    except (TypeError, ValueError):
        levels = None
    if levels is None or levels.ndim < 1 or levels.shape[-1:] != (COLOURS,) or not levels.size:
        raise HeliographError(
            f"values are numbers of shape (..., 3), such as sample gives of a frame in colour, not {shown(values)}"
        )
    if not np.isfinite(levels).all():
        raise HeliographError("values are not finite: leave out the LEDs beyond the frame, which sample gives as NaN")
    return np.asarray(levels)
