"""Panels of LEDs with any content: find, follow and sample."""

from collections.abc import Iterable, Iterator, Sequence
from numbers import Integral
from typing import Any

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.errors import HeliographError, shown
from heliograph.base.threads import in_one_thread, one_thread
from heliograph.panel import kernels
from heliograph.panel.lattice import FIRST_BLUR, MAX_BLUR, Fit, Lattice, fit, mask_of
from heliograph.panel.place import (
    COLOURS,
    MIN_PITCH_PX,
    AnyFrame,
    Levels,
    Picture,
    Place,
    Shape,
    area,
    grid,
    grow,
    homographies,
    matrix_of,
    picture_of,
    transform,
)
from heliograph.panel.search import (
    Region,
    best_candidate,
    evidence,
    fit_outline,
    quadrilateral,
    quadrilaterals,
    search_near,
    settle,
)

MIN_SIDE_PX = 8.0  # minimum side of a panel in px
ACCEPTED = 0.75  # minimum score of a correct position. Chosen from `benchmarks/panel_places.py`


def locate(
    frames: AnyFrame | Sequence[AnyFrame],
    corners: Any = None,
    region: Region | None = None,
    rows: int | None = None,
    columns: int | None = None,
) -> Place:
    """Find a panel of LEDs with any content.

    With `rows` and `columns`, the result is the grid of LEDs in the first frame, and the blur, with an error of some
    hundredths of a pixel for unclipped LEDs. The score is the probability of errors below 0.4 pitches for all LEDs,
    calibrated on drawn scenes; 0.75 and more counts as correct. Without `corners`, a lower score is an error. If `rows`
    and `columns` are unknown, the result is the outline of the LED area with an error of about a pitch, and no score.

    Parameters
    ----------
    frames
        A frame: `heliograph.Frame`, or an array (rows, columns) of gray levels or (rows, columns, 3) of colours. Or a
        list of successive frames: the search uses the lit LEDs of up to eight frames for the position in the first.
    corners
        Four manual points (x, y) in px: the corners of the LED area, upper left, upper right, lower right and lower
        left, clockwise in the image. The error may be half a pitch, or two pitches if LEDs of all outer lines are lit.
        None: search areas that are bright, coloured or change.
    region
        (x, y, columns, rows) in px of the searched part of the frame; None for the complete frame.
    rows, columns
        LEDs along a column and along a row, 2 or more; None if unknown.

    Returns
    -------
    The position, with corners in px of the frame, or of the sensor for frames with an origin.

    Raises
    ------
    HeliographError
        An argument is invalid; the corners cannot be a panel, or less than half of the panel is within the frame; or no
        panel was found with certainty.
    """
    pictures = _pictures(frames)
    shape = None if rows is None and columns is None else _known_shape(rows, columns)
    first = pictures[0]
    images = [picture.gray for picture in pictures]
    hand = None if corners is None else _corners(corners) - first.corner
    if hand is not None:
        _check_visible(hand, first, shape)
    x, y, width, height = _region(region, first)
    # another panel may be outside the region
    part, begin = np.s_[..., y : y + height, x : x + width], np.array([x, y], np.float64)
    if shape is None:
        contrast = evidence(images)[part]
        start = quadrilateral(contrast, region) + begin if hand is None else hand
        _check_visible(start, first, shape)
        found = fit_outline(contrast, start - begin) + begin
        is_valid = Shape(1, 1).is_possible(found) and 0.5 < area(found) / area(start) < 2
        return Place((found if is_valid else start) + first.corner)
    with one_thread():
        if hand is not None:
            place = _fit_candidate(images, best_candidate(images, [hand], shape, hand), shape, hand)
            return Place(place.corners + first.corner, place.blur, place.score)
        parts = [np.ascontiguousarray(image[part]) for image in images]
        starts = quadrilaterals(parts, np.ptp(first.levels[part], axis=0), shape, region)
        place = _fit_candidate(parts, best_candidate(parts, starts, shape), shape)
    if place.score < ACCEPTED or not _is_visible(place.corners, parts[0]):
        raise HeliographError(
            f"no panel of {shape.rows} x {shape.columns} LEDs was found for certain: give corners=, the four "
            "corners of the LED area in px, or several frames in which LEDs of all outer lines are lit"
        )
    return Place(place.corners + begin + first.corner, place.blur, place.score)


def follow(frames: Iterable[AnyFrame], place: Place, rows: int, columns: int) -> Iterator[Place]:
    """Follow a panel from frame to frame.

    Parameters
    ----------
    frames
        Successive frames, each as for `locate`.
    place
        Position in the first frame, from `locate`. The motion may change by half a pitch from frame to frame, or by two
        pitches if LEDs of all outer lines are lit.
    rows, columns
        LEDs along a column and along a row, 2 or more.

    Yields
    ------
    Place
        Position in each frame. The score is that of `locate`, given a correct previous position. If the panel is hidden
        or dark, the score is 0 and the corners of the previous frame are kept.

    Raises
    ------
    HeliographError
        At the call: an argument is invalid. Later: the panel is not within the first frame, or a frame is invalid.
    """
    if not isinstance(frames, Iterable):
        raise HeliographError(f"frames are an open film, or any iterable of frames, not {shown(frames)}")
    shape, start = _known_shape(rows, columns), _checked(place)
    if not shape.is_possible(start.corners):
        raise _no_panel(start.corners, "")
    return _follow(frames, start, shape)


def sample(frame: AnyFrame, place: Place, rows: int, columns: int, unblur: bool = False, leakage: Any = None) -> Floats:
    """Sample a frame at the LEDs of a panel.

    Parameters
    ----------
    frame
        A frame, as for `locate`.
    place
        Position of the panel, from `locate` or `follow`.
    rows, columns
        LEDs along a column and along a row, 2 or more.
    unblur
        True to separate the light of neighbouring LEDs by least squares over all LEDs: Gaussians with the blur of the
        place on a uniform background. Useful from 0.4 pitches of blur.
    leakage
        (3, 3) response of each channel of the camera (row) to the light of each colour (column), for example measured
        with a single lit colour; the result is multiplied by the inverse. None leaves the channels unchanged.

    Returns
    -------
    (rows, columns), or (rows, columns, 3) for a colour frame: gray levels at the LED centres; with `unblur`, the levels
    of each LED above the background. NaN for LEDs beyond the frame.

    Raises
    ------
    HeliographError
        An argument is invalid, or the panel lies beyond the frame.
    """
    shape, picture = _known_shape(rows, columns), picture_of(frame)
    matrix = _inverse_leakage(leakage, picture)
    at = _checked(place).corners - picture.corner
    _check_visible(at, picture, shape)
    images, moved = _crop(picture.levels, at, 2 * shape.pitch(at))
    corners = at - moved
    values = _unblur(images, corners, place.blur, shape) if unblur else _average(images, corners, shape)
    points = Place(corners).leds(rows, columns).reshape(-1, 2)
    values[(points < -0.5).any(axis=1) | (points > np.array(images.shape[:0:-1]) - 0.5).any(axis=1)] = np.nan
    if matrix is not None:
        values = values @ matrix.T
    return values.reshape((rows, columns) if len(images) == 1 else (rows, columns, len(images)))


def _fit_candidate(images: Sequence[Levels], candidate: Place, shape: Shape, hand: Floats | None = None) -> Fit:
    """Fit the images of LEDs from a candidate; keep the candidate if its score is higher."""
    corners = candidate.corners
    image, moved = _crop(images[0], corners, 2 * shape.pitch(corners))
    found = _fit_new(image, corners - moved, shape)
    found = found._replace(corners=found.corners + moved)
    score = settle(images, found.corners, shape, hand, shift=False).score
    is_near = np.abs(found.corners - corners).max() < shape.pitch(corners)
    # above 0.9 the fit is more accurate than the phases
    if is_near and score >= min(candidate.score, 0.9):
        return found._replace(score=score)
    return found._replace(corners=corners, score=candidate.score)


@in_one_thread
def _follow(frames: Iterable[AnyFrame], place: Place, shape: Shape) -> Iterator[Place]:
    last = before = place.corners
    held = Fit(last, place.blur if place.blur > 0 else FIRST_BLUR * shape.pitch(last), 1.0)
    for number, frame in enumerate(frames):
        picture = picture_of(frame)
        if number == 0:
            _check_visible(last - picture.corner, picture, shape)
        predicted = [corners - picture.corner for corners in (2 * last - before, last)]
        starts = [corners for corners in predicted if _is_visible(corners, picture.levels, shape)]
        found, score = _find_again(picture, starts, held, shape) if starts else (held, 0.0)
        if score and _is_visible(found.corners, picture.levels, shape):
            held, last, before = found, found.corners + picture.corner, last
            yield Place(last.copy(), found.blur, score)
        else:
            before = last
            yield Place(last.copy(), held.blur, 0.0)


def _find_again(picture: Picture, starts: Sequence[Floats], held: Fit, shape: Shape) -> tuple[Fit, float]:
    """Return the fit near the starts and its score, 0 if the panel is not visible."""
    image, moved = _crop(picture.gray, starts[0], 5 * shape.pitch(starts[0]))
    near = search_near(image, [start - moved for start in starts], shape)
    if near.score >= ACCEPTED:
        # an earlier fit starts within a tenth of a pitch, few steps are enough
        warm = held._replace(corners=near.corners)
        found = fit(image, warm, shape, 4) if held.hessian is not None else _fit_new(image, near.corners, shape)
    else:
        found = held._replace(score=-1.0)
        for start in [*(start - moved for start in starts), near.corners]:
            # try another start if the residual is larger than in the previous frame
            if 1 - found.score > 1.5 * (1 - held.score):
                found = max(found, _fit_new(image, start, shape), key=lambda candidate: candidate.score)
        if found.score < 0.5:  # no panel
            return held, 0.0
    score = settle([image], found.corners, shape, near.corners, shift=False).score
    if near.score >= ACCEPTED > score:
        found, score = found._replace(corners=near.corners), near.score
    return found._replace(corners=found.corners + moved), score


def _fit_new(image: Levels, corners: Floats, shape: Shape) -> Fit:
    """Fit from a small blur: narrow images of LEDs converge from afar, wide images explain any picture."""
    return fit(image, Fit(corners, FIRST_BLUR * shape.pitch(corners), 0.0), shape)


def _unblur(images: Levels, corners: Floats, blur: float, shape: Shape) -> Floats:
    if not blur > 0:
        raise HeliographError(
            "the blur of the place is not known: locate(..., rows=, columns=) finds it, or give Place(corners, blur)"
        )
    if blur > MAX_BLUR * shape.pitch(corners):
        raise HeliographError(
            f"the LEDs lie {shape.pitch(corners):.1f} px apart, too close for a blur of {blur:.1f} px: sample without "
            "unblur, or give the blur that locate finds"
        )
    mask = mask_of(corners, images.shape[1:], 0.6 * shape.pitch(corners))
    with one_thread():
        lattice = Lattice(shape, corners, blur, mask)
        light, _ = lattice.light(images * mask)
    # peak of a Gaussian with this light
    return light / (2 * np.pi * lattice.sigma**2)


def _average(images: Levels, corners: Floats, shape: Shape) -> Floats:
    """Average pixels at LEDs with Gaussian weights."""
    points = Place(corners).leds(shape.rows, shape.columns).reshape(-1, 2)
    # for 1.4 to 4 standard deviations of blur per pitch, 0.1 and 0.2 gave the same bit errors, 0.3 up to ten times as
    # many; below 0.6 px a Gaussian falls between pixels
    width = max(0.15 * shape.pitch(corners), 0.6)
    out = np.empty((len(images) + 1, len(points), 4))
    # the last image gives the sum of the weights, which is smaller at the frame's edge
    for image, products in zip((*images, np.ones(images.shape[1:], np.float32)), out, strict=True):
        kernels.project(image, points, width, 3 * width, products)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((out[:-1, :, 0] / out[-1, :, 0]).T)


def _crop(levels: Levels, corners: Floats, margin: float) -> tuple[Levels, Floats]:
    """Crop levels (..., rows, columns) around a panel; return the crop and the first pixel (x, y)."""
    outer = grow(corners, margin)
    rows, columns = levels.shape[-2:]
    x0, y0 = np.clip(np.floor(outer.min(axis=0)).astype(int), 0, [columns - 1, rows - 1])
    x1, y1 = np.clip(np.ceil(outer.max(axis=0)).astype(int) + 1, [x0 + 1, y0 + 1], [columns, rows])
    return np.ascontiguousarray(levels[..., y0:y1, x0:x1]), np.array([x0, y0], np.float64)


def _is_visible(corners: Floats, levels: Levels, shape: Shape | None = None) -> bool:
    """Return True if a panel can have such corners, and half of the panel or more is within the levels."""
    if not (shape or Shape(1, 1)).is_possible(corners) or abs(area(corners)) < MIN_SIDE_PX**2:
        return False
    points = transform(homographies(corners), grid(8, 8))
    return bool(((points > -0.5) & (points < np.array(levels.shape[:-3:-1]) - 0.5)).all(axis=1).mean() >= 0.5)


def _check_visible(corners: Floats, picture: Picture, shape: Shape | None) -> None:
    if not _is_visible(corners, picture.levels, shape):
        rows, columns = picture.levels.shape[1:]
        raise _no_panel(corners + picture.corner, f" in a frame of {columns}x{rows} pixels")


def _no_panel(corners: Floats, where: str) -> HeliographError:
    text = ", ".join(f"{x:.0f} {y:.0f}" for x, y in corners)
    return HeliographError(
        f"the corners {text} are no panel{where}: give x, y of upper left, upper right, lower right and lower left, at "
        f"least half of the panel within the frame, {MIN_PITCH_PX:g} px or more from LED to LED"
    )


def _pictures(frames: Any) -> list[Picture]:
    several = frames if isinstance(frames, (list, tuple)) else [frames]
    if not several:
        raise HeliographError("locate takes a frame or a list of frames, not an empty one")
    pictures = [picture_of(frame) for frame in several]
    if len({(picture.levels.shape, *picture.corner) for picture in pictures}) > 1:
        raise HeliographError("frames of a list have one size, place and number of colours: give frames of one camera")
    return pictures


def _known_shape(rows: Any, columns: Any) -> Shape:
    for name, count in (("rows", rows), ("columns", columns)):
        if not isinstance(count, Integral) or count < 2:
            raise HeliographError(f"{name} of LEDs are an integer, 2 or more, not {shown(count)}")
    if rows * columns > 65536:  # unblurring takes 0.3 to 0.6 GB
        raise HeliographError(f"a panel has at most 65536 LEDs, not {rows} x {columns}: take a part of it")
    return Shape(int(rows), int(columns))


def _corners(corners: Any) -> Floats:
    points = "four points (x, y) in px, such as [(10, 10), (90, 12), (88, 95), (9, 90)]"
    return matrix_of(corners, (4, 2), f"corners are {points}")


def _checked(place: Any) -> Place:
    if not isinstance(place, Place):
        raise HeliographError(
            f"a place is a result of locate, or heliograph.panel.Place(corners, blur), not {shown(place)}"
        )
    return Place(_corners(place.corners), place.blur, place.score)


def _region(region: Any, picture: Picture) -> Region:
    rows, columns = picture.levels.shape[1:]
    if region is None:
        return 0, 0, columns, rows
    numbers = isinstance(region, (list, tuple)) and len(region) == 4 and all(isinstance(n, Integral) for n in region)
    if not numbers:
        raise HeliographError(f"a region is (x, y, columns, rows) in integer pixels, not {shown(region)}")
    (x, y), (width, height) = np.array(region[:2]) - picture.corner.astype(int), region[2:]
    x0, y0, x1, y1 = max(x, 0), max(y, 0), min(x + width, columns), min(y + height, rows)
    if x1 - x0 < MIN_SIDE_PX or y1 - y0 < MIN_SIDE_PX:
        raise HeliographError(
            f"the region {','.join(map(str, region))} has no {MIN_SIDE_PX:g} x {MIN_SIDE_PX:g} pixels of the "
            f"frame, which is {columns}x{rows}"
        )
    return x0, y0, x1 - x0, y1 - y0


def _inverse_leakage(leakage: Any, picture: Picture) -> Floats | None:
    if leakage is None:
        return None
    if len(picture.levels) != COLOURS:
        raise HeliographError("leakage is between colours: the frame has one channel")
    rule = "leakage is a matrix (3, 3) that has an inverse: the response of each channel (row) to each colour (column)"
    matrix = matrix_of(leakage, (COLOURS, COLOURS), rule)
    if np.linalg.matrix_rank(matrix) < COLOURS:
        raise HeliographError(f"{rule}, not {shown(leakage)}")
    return np.asarray(np.linalg.inv(matrix), np.float64)
