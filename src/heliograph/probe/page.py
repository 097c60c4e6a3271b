"""HTML page of the findings: pictures, tables and remedies."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from heliograph.base.files import shown_name
from heliograph.base.frames import Frame
from heliograph.base.words import counted
from heliograph.experiments.plots import BLUE, DARK_GRAY, GRAY, GREEN, ORANGE, RED, tidy
from heliograph.experiments.report import Report
from heliograph.probe.activity import Stretch
from heliograph.probe.causes import RegionSeen
from heliograph.probe.film import Findings
from heliograph.probe.noise import NoiseFound
from heliograph.probe.regions import Region
from heliograph.probe.words import array_lines, cause_words, lines, noise_words, place, would_be_lines
from heliograph.receive.detect.alternation import ALTERNATION
from heliograph.receive.geometry.window import Window, cut_out
from heliograph.signal.settings import LAYERS

WIDE = 11.0
"""Width of a picture in inches."""

TALLEST, LOWEST = 7.5, 1.4
"""Most and least height of the frame's picture in inches."""

ROOM = 0.85
"""Part of the frame from its left, or from its bottom, within which there is room for a label to the right, or
above."""


def colour_of(seen: RegionSeen) -> str:
    """Colour that marks a region: green where it is read, orange where it could be, red for an array that is not."""
    if seen.array is not None:
        return GREEN
    if seen.found is not None:
        return ORANGE
    return RED if seen.like_array else GRAY


def frame_with_regions(stretch: Stretch, regions: Sequence[RegionSeen]) -> Figure:
    """The middle frame of the stretch that was looked into, its regions marked and numbered."""
    frame = stretch.frames[len(stretch.frames) // 2]
    rows, cols = frame.pixels.shape
    # most pixels of a row or a column of the frame that are drawn: of larger frames every second one, and so on
    step = max(1, -(-max(rows, cols) // 1600))
    figure = Figure(figsize=(WIDE, float(np.clip(WIDE * rows / cols + 0.5, LOWEST, TALLEST))))
    axes = figure.add_subplot()
    left, top = frame.origin
    extent = (left - 0.5, left + cols - 0.5, top + rows - 0.5, top - 0.5)
    axes.imshow(frame.pixels[::step, ::step], cmap="gray", vmin=0, vmax=_white(frame), extent=extent)
    for number, seen in enumerate(regions, 1):
        _mark(axes, seen, number, len(stretch.frames), (left, top, cols, rows))
    axes.set_title(f"frame {frame.index}", fontsize=10)
    axes.set_xlim(extent[0], extent[1])
    axes.set_ylim(extent[2], extent[3])
    axes.set_xlabel("x (px)")
    axes.set_ylabel("y (px)")
    figure.tight_layout()
    return figure


def _mark(axes: Axes, seen: RegionSeen, number: int, frames: int, whole: Window) -> None:
    left, top, cols, rows = whole
    x, y, width, height = seen.region.box_at(frames // 2, frames)
    pad = max(2.0, 0.006 * cols)
    x0, x1 = max(x - pad, left), min(x + width - 1 + pad, left + cols - 1)
    y0, y1 = max(y - pad, top), min(y + height - 1 + pad, top + rows - 1)
    colour = colour_of(seen)
    # a white line around it, so that it shows on any ground
    for line, paint in ((3.2, "white"), (1.6, colour)):
        axes.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], color=paint, lw=line)
    name = f"{number}: {seen.causes[0].kind if seen.causes else ''}"
    name = f"{number}: array {seen.array.identity}" if seen.array is not None else name
    # within the frame: to the left of what lies at its right, below what lies at its top
    right, upper = x1 > left + ROOM * cols, y0 < top + (1 - ROOM) * rows
    axes.annotate(
        name, (x1, y1 if upper else y0), xytext=(-3 if right else 3, -3 if upper else 3), textcoords="offset points",
        fontsize=9, color="white", ha="right" if right else "left", va="top" if upper else "bottom",
        bbox={"boxstyle": "round,pad=0.2", "fc": colour, "ec": "white", "lw": 0.6},
    )  # fmt: skip


def region_picture(stretch: Stretch, seen: RegionSeen) -> Figure:
    """A region: two frames, what alternates in them, and their sum; and its brightness over the stretch."""
    frames, region = stretch.frames, seen.region
    k = _liveliest(frames, region)
    four = frames[k : k + 4]
    window = _surroundings(region, k + 1.5, len(frames), frames[0])
    one, other = (cut_out(frame, window) for frame in four[:2])
    change = np.asarray(sum(w * cut_out(frame, window) for w, frame in zip(ALTERNATION, four, strict=True)))
    figure = Figure(figsize=(WIDE, 4.6))
    grid = figure.add_gridspec(2, 4, height_ratios=(1.5, 1))
    white = _white(four[0], float(max(one.max(), other.max())))
    images: list[tuple[NDArray[Any], str, str, float, float]] = [
        (one, f"frame {four[0].index}", "gray", 0, white),
        (other, f"frame {four[1].index}", "gray", 0, white),
        (change, "what alternates", "RdBu_r", -float(np.abs(change).max()), float(np.abs(change).max())),
        (one + other, "sum of both", "gray", 0, 2 * white),
    ]
    for column, (image, title, colours, low, high) in enumerate(images):
        axes = figure.add_subplot(grid[0, column])
        axes.imshow(image, cmap=colours, vmin=low, vmax=max(high, low + 1e-6), interpolation="nearest")
        axes.set_title(title, fontsize=9)
        axes.set_axis_off()
    _timeline(figure.add_subplot(grid[1, :]), frames, seen, k)
    figure.tight_layout()
    return figure


def _timeline(axes: Axes, frames: Sequence[Frame], seen: RegionSeen, k: int) -> None:
    numbers = np.array([frame.index for frame in frames])
    axes.plot(numbers, seen.region.brightness, color=BLUE, lw=0.9, label="mean gray level of the region")
    axes.axvspan(numbers[k] - 0.5, numbers[k + 1] + 0.5, color=ORANGE, alpha=0.35, lw=0, label="the frames above")
    header = seen.header
    if header is not None and seen.like_array and header.starts:
        step = seen.rate.frames if seen.rate is not None and seen.rate.frames > 1.02 else 1.0
        for place, start in enumerate(header.starts):
            at = numbers[min(round(start * step), len(numbers) - 1)]
            axes.axvline(at, color=GREEN, lw=1.1, ls="--", label="a header begins" if place == 0 else None)
    tidy(axes)
    axes.set_xlabel("frame")
    axes.set_ylabel("gray level")
    axes.set_xlim(numbers[0], max(numbers[-1], numbers[0] + 1))
    axes.legend(frameon=False, fontsize=8, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=3)


def noise_picture(noise: NoiseFound) -> Figure:
    """Variance of pixels that stand still by their gray level, and the line through it."""
    figure = Figure(figsize=(5.6, 3.4))
    axes = figure.add_subplot()
    points = np.array(noise.points)
    axes.plot(points[:, 0], points[:, 1], "o", color=BLUE, ms=4, label="blocks that stand still")
    if noise.line is not None:
        x = np.array([0.0, points[:, 0].max()])
        axes.plot(x, noise.line[0] + noise.line[1] * x, color=DARK_GRAY, lw=1, label="line through them")
        axes.set_xlim(left=0)
    axes.set_ylim(0, 1.15 * points[:, 1].max())
    axes.set_xlabel("gray level")
    axes.set_ylabel("variance of a pixel")
    axes.legend(frameon=False, fontsize=8, loc="lower right")
    tidy(axes)
    figure.tight_layout()
    return figure


def _surroundings(region: Region, number: float, frames: int, frame: Frame) -> Window:
    """A rectangle about a region, no larger than the frame."""
    centre, wanted = region.centre_at(number, frames), (region.width, region.height)
    corner, size = [], []
    for at, length, first, most in zip(centre, wanted, frame.origin, frame.pixels.shape[::-1], strict=True):
        # side of a cut-out over that of its region
        # least side of a cut-out in px
        size.append(int(min(max(round(1.8 * length), 24), most)))
        corner.append(int(np.clip(round(at - 0.5 * (size[-1] - 1)), first, first + most - size[-1])))
    return corner[0], corner[1], size[0], size[1]


def _liveliest(frames: Sequence[Frame], region: Region) -> int:
    """Number of the first of four frames in which most alternates."""
    count, best = len(frames), (0.0, 0)
    for k in range(0, count - 3, max(1, count // 128)):
        box = region.box_at(k + 1.5, count)
        four = zip(ALTERNATION, frames[k : k + 4], strict=True)
        change = np.asarray(sum(weight * cut_out(frame, box) for weight, frame in four))
        best = max(best, (float((change**2).mean()), k))
    return best[1]


def _white(frame: Frame, brightest: float | None = None) -> float:
    """Gray level that is drawn white: dark films are brightened."""
    most = float(np.quantile(frame.pixels, 0.999)) if brightest is None else brightest
    return max(min(1.2 * most, float(frame.full_scale)), 0.04 * frame.full_scale)


def write_page(path: Path, found: Findings) -> None:
    """Write the page, whole or not at all."""
    page = Report(f"Probe of {shown_name(found.path)}")
    page.text(_verdict(found))
    if found.advice:
        page.heading("What to change")
        page.table(["advice"], [[line] for line in found.advice], prose=True)
    _film(page, found)
    if found.stretch is not None and found.regions:
        _regions(page, found)
    elif found.stretch is not None:
        page.heading("Where something blinks")
        page.figure(frame_with_regions(found.stretch, ()), "A frame from the film. Nothing in it blinks.")
    _arrays(page, found)
    _noise(page, found)
    page.heading("As text")
    page.code("\n".join(lines(found)))
    page.write(path)


def _verdict(found: Findings) -> str:
    if found.read:
        names = ", ".join(f"array {one.identity} ({one.orientation})" for one in found.arrays)
        return f"Read with the settings as they are: {names}."
    if found.regions:
        one = "One region blinks or moves"
        many = f"{found.regions_in_all} regions blink or move" if found.regions_in_all > 1 else one
        return f"No array was read. {many}; below stands why."
    return "No array was read, and nothing blinks."


def _film(page: Report, found: Findings) -> None:
    page.heading("The film")
    rows = [
        line.split(": ", 1) for line in lines(found) if line.startswith(("stamps: ", "light: ", "levels: ", "noise: "))
    ]
    size = f"{counted(found.times.count, 'frame')} of {found.width} x {found.height} px, {found.bits} bits"
    trouble = [["trouble", cause_words(cause)] for cause in found.causes]
    receiver = [["receiver", found.error]] if found.error else []
    page.table(["", "found"], [["frames", size], *rows, *trouble, *receiver], prose=True)


def _regions(page: Report, found: Findings) -> None:
    stretch = found.stretch
    assert stretch is not None
    first, last = stretch.frames[0].index, stretch.frames[-1].index
    page.heading("Where something blinks")
    caption = f"Regions that blink most in frames {first} to {last}, each with its verdict."
    page.figure(frame_with_regions(stretch, found.regions), caption)
    head = ["region", "place (px)", "size (px)", "speed (px a frame)", "contrast", "frames a pattern", "header"]
    page.table(head, [_row(number, seen) for number, seen in enumerate(found.regions, 1)])
    for number, seen in enumerate(found.regions, 1):
        page.heading(f"Region {number}: {seen.causes[0].kind if seen.causes else ''}")
        for cause in seen.causes:
            page.text(cause_words(cause))
        for line in would_be_lines(seen):
            page.text(f"{line.strip()}.", note=True)
        caption = f"Region {number}, {place(seen)}. Two frames, what alternates, their sum; below, its brightness."
        page.figure(region_picture(stretch, seen), caption)


def _row(number: int, seen: RegionSeen) -> list[str]:
    region = seen.region
    header = seen.header.score if seen.header else None
    score = seen.array.score if seen.array is not None else header
    return [
        str(number), f"{region.x:.0f}, {region.y:.0f}", f"{region.width:.1f} x {region.height:.1f}",
        f"{region.speed_px:.2f}", f"{region.contrast:.3f}", f"{seen.rate.frames:.2f}" if seen.rate else "-",
        "-" if score is None else f"{score:.2f}",
    ]  # fmt: skip


def _arrays(page: Report, found: Findings) -> None:
    if not found.arrays:
        return
    page.heading("Arrays that are read")
    for array in found.arrays:
        head, *rest = array_lines(array)
        page.text(f"{head[0].upper()}{head[1:]}.")
        page.table(["", "found"], [["", line.strip()] for line in rest if "expected" not in line], prose=True)
        if array.reach:
            rows = [[one.receiver, *(_metres(one.distance_m[name]) for name in LAYERS)] for one in array.reach]
            page.table(["receiver", *(f"{name} layer to" for name in LAYERS)], rows)
            page.text(
                "Distances are an estimate, by the array's light, its noise and its blur in this film.", note=True
            )


def _metres(distance_m: float) -> str:
    return f"{distance_m:.0f} m" if 0 < distance_m < float("inf") else ("any distance" if distance_m else "none")


def _noise(page: Report, found: Findings) -> None:
    if not found.noise.points:
        return
    page.heading("Noise")
    words = noise_words(found.noise)
    page.figure(noise_picture(found.noise), f"Noise by photon transfer: {words}.")
