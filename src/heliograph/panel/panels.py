"""Any panel of LEDs by hand, without this project's packets: where it is, where it goes, what its LEDs show."""

from collections.abc import Iterable, Iterator, Sequence
from numbers import Integral
from typing import Any

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.errors import HeliographError, shown
from heliograph.base.threads import in_one_thread, one_thread
from heliograph.panel.lattice import FIRST_BLUR, MOST_BLUR, Fitted, Lattice, Shape, fitted
from heliograph.panel.place import (
    COLOURS,
    LIMITS,
    AnyFrame,
    Levels,
    Picture,
    Place,
    area,
    grid,
    grown,
    homographies,
    is_possible,
    mapped,
    picture_of,
)
from heliograph.panel.search import (
    SMOOTHING,
    Candidate,
    Region,
    best_candidate,
    evidence,
    found_again,
    outlined,
    quadrilateral,
    quadrilaterals,
    settled,
)

MOST_LEDS = 1 << 16
"""Most LEDs of a panel: with 256 x 256 undoing the blur takes 0.3 to 0.6 GB."""

LEAST_SIDE_PX = 8.0
"""Least side of a panel in px: of less nothing is told."""

ACCEPTED = 0.75
"""Least score of a place that is taken for right. Chosen from `benchmarks/panel_places.py`."""

PLAIN_WIDTH, LEAST_WIDTH_PX = 0.15, 0.6
"""Width in pitches, and the least in px, of the Gaussian with which pixels about an LED are weighted.

Of panels with 1.4 to 4 standard deviations of blur a pitch 0.1 and 0.2 left as many bits wrong, 0.3 up to ten times as
many. Below 0.6 px a Gaussian falls between the pixels.
"""


def locate(
    frames: AnyFrame | Sequence[AnyFrame],
    corners: Any = None,
    region: Region | None = None,
    rows: int | None = None,
    columns: int | None = None,
) -> Place:
    """Find where a panel of LEDs is, whatever it shows.

    With `rows` and `columns` the place is that of the LEDs' grid in the first frame, with the blur: to some hundredths
    of a pixel if the LEDs are not clipped. Its score is the probability that no LED is off by 0.4 pitches or more,
    calibrated on drawn scenes: 0.75 and more counts as right. Without `corners` a place below that is an error.
    Without `rows` and `columns` the place is the outline of the LED area, to about a pitch, without a score.

    Parameters
    ----------
    frames
        A frame: `heliograph.Frame`, or an array (rows, columns) of gray levels or (rows, columns, 3) of colours. Or a
        list of successive frames: the lit LEDs of up to eight frames count together; the place is that in the first.
    corners
        Four points (x, y) in px, as given by hand: the corners of the LED area, upper left, upper right, lower right
        and lower left, clockwise in the image; they may be off by about half a pitch, or by two pitches if LEDs of all
        outer lines are lit. None: areas that are bright, coloured or change are searched.
    region
        (x, y, columns, rows) in px of the part of the frame that is searched; None for all of it.
    rows, columns
        LEDs along a column and along a row, 2 or more of each; None where they are not known.

    Returns
    -------
    The place, its corners in px of the frame, or of the sensor where a frame has an origin.

    Raises
    ------
    HeliographError
        The arguments are none of these; the corners are no quadrilateral that a camera may see of such a panel, or less
        than half of it lies within the frame; or no panel was found for certain without corners.
    """
    pictures = _pictures(frames)
    shape = _shape(rows, columns)
    first = pictures[0]
    images = [one.gray for one in pictures]
    hand = None if corners is None else _corners(corners) - first.corner
    if hand is not None:
        _check_there(hand, first, shape)
    x, y, width, height = _region(region, first)
    # what lies beyond the region may be another panel's
    part, begin = np.s_[..., y : y + height, x : x + width], np.array([x, y], np.float64)
    if shape is None:
        shows = evidence(images)[part]
        start = quadrilateral(shows, region) + begin if hand is None else hand
        _check_there(start, first, shape)
        widths = [share * area(start) ** 0.5 for share in SMOOTHING]
        return Place(_kept(outlined(shows, start - begin, widths) + begin, start) + first.corner)
    parts = [np.ascontiguousarray(one[part]) for one in images]
    with one_thread():
        if hand is None:
            starts = quadrilaterals(parts, np.ptp(first.levels[part], axis=0), shape, region)
            found = _fitted_place(parts, best_candidate(parts, starts, shape), shape)
            if found.score < ACCEPTED or not _is_there(found.corners, Picture(parts[0][None])):
                raise HeliographError(
                    f"no panel of {shape.rows} x {shape.columns} LEDs was found for certain: give corners=, the four "
                    "corners of the LED area in px, or several frames in which LEDs of all outer lines are lit"
                )
            return Place(found.corners + begin + first.corner, found.blur, found.score)
        found = _fitted_place(images, best_candidate(images, [hand], shape, hand), shape, hand)
    return Place(found.corners + first.corner, found.blur, found.score)


def follow(frames: Iterable[AnyFrame], place: Place, rows: int, columns: int) -> Iterator[Place]:
    """Follow a panel from frame to frame.

    Parameters
    ----------
    frames
        Successive frames, each as for `locate`.
    place
        Where the panel is in the first of them, of `locate`. Its motion may change by half a pitch from frame to frame,
        or by up to two pitches if LEDs of all outer lines are lit.
    rows, columns
        LEDs along a column and along a row, 2 or more of each.

    Yields
    ------
    Place
        The place in each frame, with a score as of `locate`, given that the place before was right. If the panel is not
        seen, as it is hidden or shows nothing, the score is 0 and the corners are those of the frame before.

    Raises
    ------
    HeliographError
        At once: the arguments are none of these. Later: the place is not in the first frame, or a frame is none.
    """
    if not isinstance(frames, Iterable):
        raise HeliographError(f"frames are an open film, or any iterable of frames, not {shown(frames)}")
    shape, start = _shape(rows, columns), _checked(place)
    assert shape is not None
    if not is_possible(start.corners, shape.rows, shape.columns):
        raise _no_panel(start.corners, "")
    return _followed(frames, start, shape)


def sample(frame: AnyFrame, place: Place, rows: int, columns: int, unblur: bool = False, leakage: Any = None) -> Floats:
    """Values at the LEDs of a panel.

    Parameters
    ----------
    frame
        A frame, as for `locate`.
    place
        Where the panel is in it, of `locate` or `follow`.
    rows, columns
        LEDs along a column and along a row, 2 or more of each.
    unblur
        Whether light of neighbouring LEDs is told apart: least squares over all LEDs, each a Gaussian of the place's
        blur, before an even background. It is worth it from about 0.4 pitches of blur on.
    leakage
        (3, 3) what each channel of the camera (row) sees of the light of each colour (column), such as measured with
        one colour lit at a time: its inverse is applied. None: channels stay as they are.

    Returns
    -------
    (rows, columns), or (rows, columns, 3) of a frame in colour: gray levels at the LEDs' centres; with `unblur` those
    that each LED alone adds to the background. NaN for LEDs beyond the frame.

    Raises
    ------
    HeliographError
        The arguments are none of these, or the place lies beyond the frame.
    """
    shape, picture = _shape(rows, columns), picture_of(frame)
    assert shape is not None
    matrix = _leakage(leakage, picture)
    at = _checked(place).corners - picture.corner
    _check_there(at, picture, shape)
    images, moved = _about(picture, at, 2 * shape.pitch(at))
    corners = at - moved
    values = _unblurred(images, corners, place.blur, shape) if unblur else _weighted(images, corners, shape)
    points = Place(corners).leds(rows, columns).reshape(-1, 2)
    beyond = (points < -0.5).any(axis=1) | (points > np.array(images.shape[:0:-1]) - 0.5).any(axis=1)
    values[beyond] = np.nan
    if matrix is not None:
        values = values @ matrix.T
    return values.reshape((rows, columns) if len(images) == 1 else (rows, columns, len(images)))


def _fitted_place(images: Sequence[Levels], candidate: Candidate, shape: Shape, hand: Floats | None = None) -> Fitted:
    """The candidate after the fit of its LEDs' images; or as it was where it agreed better."""
    corners = candidate.corners
    image, moved = _about(Picture(images[0][None]), corners, 2 * shape.pitch(corners))
    fit = _afresh(image[0], corners - moved, shape)
    fit = fit._replace(corners=fit.corners + moved)
    again = settled(images, fit.corners, shape, hand, shift=False)
    is_near = np.abs(fit.corners - corners).max() < shape.pitch(corners)
    # score that a fit may fall to: beyond it the fit's corners are more exact than the phases'
    if is_near and again.score >= min(candidate.score, 0.9):
        return fit._replace(score=again.score)
    return fit._replace(corners=corners, score=candidate.score)


@in_one_thread
def _followed(frames: Iterable[AnyFrame], place: Place, shape: Shape) -> Iterator[Place]:
    last = before = place.corners
    held = Fitted(last, place.blur if place.blur > 0 else FIRST_BLUR * shape.pitch(last), 1.0)
    for number, frame in enumerate(frames):
        picture = picture_of(frame)
        if number == 0:
            _check_there(last - picture.corner, picture, shape)
        starts = [one for one in (2 * last - before, last) if _is_there(one - picture.corner, picture, shape)]
        found, score = held, 0.0
        if starts:
            found, score = _found_on(picture, [one - picture.corner for one in starts], held, shape)
        if not score or not _is_there(found.corners, picture, shape):
            before = last
            yield Place(last.copy(), held.blur, 0.0)
            continue
        held, last, before = found, found.corners + picture.corner, last
        yield Place(last.copy(), found.blur, score)


def _found_on(picture: Picture, starts: Sequence[Floats], held: Fitted, shape: Shape) -> tuple[Fitted, float]:
    """The panel's place in a picture near the starts, and its score; 0 if it is not seen."""
    images, moved = _about(Picture(picture.gray[None]), starts[0], 5 * shape.pitch(starts[0]))
    image = images[0]
    near = found_again(image, [one - moved for one in starts], shape)
    if near.score >= ACCEPTED:
        at = near.corners
        if held.hessian is not None:  # an earlier fit leaves little to do
            # most steps of a fit from frame to frame: it starts within a tenth of a pitch where the grid shows
            found = fitted(image, held._replace(corners=at), shape, 4)
        else:
            found = _afresh(image, at, shape)
    else:
        found = held._replace(score=-1.0)
        for start in [*(one - moved for one in starts), near.corners]:
            # what is as well explained as before is right
            # Ratio of what a fit leaves unexplained to what the frame's before did, above which another start is tried.
            # Chosen
            if 1 - found.score > 1.5 * (1 - held.score):
                found = max(found, _afresh(image, start, shape), key=lambda one: one.score)
        # Least correlation of the pixels with the fitted image of a panel whose grid does not show. Chosen
        if found.score < 0.5:
            return held, 0.0
    score = settled([image], found.corners, shape, near.corners, shift=False).score
    if near.score >= ACCEPTED > score:
        found, score = found._replace(corners=near.corners), near.score
    return found._replace(corners=found.corners + moved), score


def _afresh(image: Levels, corners: Floats, shape: Shape) -> Fitted:
    """A fit without an earlier one: narrow images of LEDs draw it from afar, wide ones explain whatever there is."""
    return fitted(image, Fitted(corners, FIRST_BLUR * shape.pitch(corners), 0.0), shape)


def _unblurred(images: Levels, corners: Floats, blur: float, shape: Shape) -> Floats:
    if not blur > 0:
        raise HeliographError(
            "the blur of the place is not known: locate(..., rows=, columns=) finds it, or give Place(corners, blur)"
        )
    if blur > MOST_BLUR * shape.pitch(corners):
        raise HeliographError(
            f"the LEDs lie {shape.pitch(corners):.1f} px apart, too close for a blur of {blur:.1f} px: sample without "
            "unblur, or give the blur that locate finds"
        )
    mask = shape.mask(corners, (images.shape[1], images.shape[2]))
    with one_thread():
        lattice = Lattice(shape, corners, blur, mask)
        light, _ = lattice.light(images * mask)
    # the peak of a Gaussian of that light
    return light / (2 * np.pi * lattice.sigma**2)


def _weighted(images: Levels, corners: Floats, shape: Shape) -> Floats:
    from heliograph.panel import kernels  # Numba is slow to import

    points = Place(corners).leds(shape.rows, shape.columns).reshape(-1, 2)
    width = max(PLAIN_WIDTH * shape.pitch(corners), LEAST_WIDTH_PX)
    out = np.empty((len(images), len(points), 4))
    level = np.empty((len(points), 4))
    # of LEDs at the frame's edge a part of the weights lies beyond it
    kernels.gathered(np.ones(images.shape[1:], np.float32), points, width, 3 * width, level)
    for image, one in zip(images, out, strict=True):
        kernels.gathered(image, points, width, 3 * width, one)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((out[..., 0] / level[:, 0]).T)


def _about(picture: Picture, corners: Floats, margin: float) -> tuple[Levels, Floats]:
    """The part (channels, rows, columns) of a picture about a panel, and the place (x, y) of its first pixel."""
    outer = grown(corners, margin)
    rows, columns = picture.levels.shape[1:]
    x0, y0 = np.clip(np.floor(outer.min(axis=0)).astype(int), 0, [columns - 1, rows - 1])
    x1, y1 = np.clip(np.ceil(outer.max(axis=0)).astype(int) + 1, [x0 + 1, y0 + 1], [columns, rows])
    return np.ascontiguousarray(picture.levels[:, y0:y1, x0:x1]), np.array([x0, y0], np.float64)


def _kept(corners: Floats, start: Floats) -> Floats:
    """Fitted corners, or where they went astray those from which the fit started."""
    return corners if is_possible(corners) and 0.5 < area(corners) / area(start) < 2 else start


def _is_there(corners: Floats, picture: Picture, shape: Shape | None = None) -> bool:
    """True if a panel may have such corners, and at least half of it lies within the picture."""
    rows, columns = picture.levels.shape[1:]
    if not is_possible(corners, *((shape.rows, shape.columns) if shape else (1, 1))):
        return False
    if abs(area(corners)) < LEAST_SIDE_PX**2:
        return False
    x, y = mapped(homographies(corners), grid(8, 8)).T
    # smallest share of a panel within the frame: of less neither grid nor outline tells
    return bool(((x > -0.5) & (x < columns - 0.5) & (y > -0.5) & (y < rows - 0.5)).mean() >= 0.5)


def _check_there(corners: Floats, picture: Picture, shape: Shape | None) -> None:
    if not _is_there(corners, picture, shape):
        rows, columns = picture.levels.shape[1:]
        raise _no_panel(corners + picture.corner, f" in a frame of {columns}x{rows} pixels")


def _no_panel(corners: Floats, where: str) -> HeliographError:
    text = ", ".join(f"{x:.0f} {y:.0f}" for x, y in corners)
    return HeliographError(
        f"the corners {text} are no panel{where}: give x, y of upper left, upper right, lower right and lower left, at "
        f"least half of the panel within the frame, {LIMITS.pitch_px:g} px or more from LED to LED"
    )


def _pictures(frames: Any) -> list[Picture]:
    several = frames if isinstance(frames, (list, tuple)) else [frames]
    if not several:
        raise HeliographError("locate takes a frame or a list of frames, not an empty one")
    pictures = [picture_of(one) for one in several]
    if any(one.levels.shape != pictures[0].levels.shape or one.origin != pictures[0].origin for one in pictures):
        raise HeliographError("frames of a list have one size, place and number of colours: give those of one camera")
    return pictures


def _shape(rows: Any, columns: Any) -> Shape | None:
    if rows is None and columns is None:
        return None
    for name, count in (("rows", rows), ("columns", columns)):
        if not isinstance(count, Integral) or count < 2:
            raise HeliographError(f"{name} of LEDs are a whole number, 2 or more, not {shown(count)}")
    if rows * columns > MOST_LEDS:
        raise HeliographError(f"a panel has at most {MOST_LEDS} LEDs, not {rows} x {columns}: take a part of it")
    return Shape(int(rows), int(columns))


def _corners(corners: Any) -> Floats:
    try:
        found = np.array(corners, np.float64)
    except (TypeError, ValueError):
        found = np.empty(0)
    if found.shape != (4, 2) or not np.isfinite(found).all():
        raise HeliographError(
            f"corners are four points (x, y) in px, such as [(10, 10), (90, 12), (88, 95), (9, 90)], not "
            f"{shown(corners)}"
        )
    return found


def _checked(place: Any) -> Place:
    if not isinstance(place, Place):
        raise HeliographError(
            f"a place is what locate gives, or heliograph.panel.Place(corners, blur), not {shown(place)}"
        )
    return Place(_corners(place.corners), place.blur, place.score)


def _region(region: Any, picture: Picture) -> Region:
    rows, columns = picture.levels.shape[1:]
    if region is None:
        return 0, 0, columns, rows
    numbers = isinstance(region, (list, tuple)) and len(region) == 4 and all(isinstance(n, Integral) for n in region)
    if not numbers:
        raise HeliographError(f"a region is (x, y, columns, rows) in whole pixels, not {shown(region)}")
    x, y, width, height = (int(n) for n in region)
    x, y = x - picture.origin[0], y - picture.origin[1]
    x0, y0, x1, y1 = max(x, 0), max(y, 0), min(x + width, columns), min(y + height, rows)
    if x1 - x0 < LEAST_SIDE_PX or y1 - y0 < LEAST_SIDE_PX:
        raise HeliographError(
            f"the region {','.join(map(str, region))} has no {LEAST_SIDE_PX:g} x {LEAST_SIDE_PX:g} pixels of the "
            f"frame, which is {columns}x{rows}"
        )
    return x0, y0, x1 - x0, y1 - y0


def _leakage(leakage: Any, picture: Picture) -> Floats | None:
    if leakage is None:
        return None
    if len(picture.levels) != COLOURS:
        raise HeliographError("leakage is between colours: the frame has one channel")
    try:
        matrix = np.asarray(leakage, np.float64).reshape(COLOURS, COLOURS)
        return np.asarray(np.linalg.inv(matrix), np.float64)
    except (TypeError, ValueError, np.linalg.LinAlgError):
        raise HeliographError(
            f"leakage is a matrix (3, 3) that has an inverse: what each channel (row) sees of each colour (column), "
            f"not {shown(leakage)}"
        ) from None
