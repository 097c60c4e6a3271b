"""HTML page of a diagnosis: pictures, tables and remedies."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from heliograph.base.errors import counted
from heliograph.base.files import shown_name
from heliograph.base.frames import Frame
from heliograph.experiments.plots import BLUE, DARK_GRAY, GRAY, GREEN, ORANGE, RED, styled
from heliograph.experiments.report import Report
from heliograph.probe.activity import Stretch
from heliograph.probe.causes import RegionReport
from heliograph.probe.film import Findings
from heliograph.probe.noise import NoiseEstimate
from heliograph.probe.regions import alternation
from heliograph.probe.words import array_lines, cause_words, film_lines, noise_words, place, size_words, would_be_lines
from heliograph.receive.geometry.window import Window, cut_out

WIDTH_INCHES = 11.0


def frame_picture(stretch: Stretch, reports: Sequence[RegionReport]) -> Figure:
    """Draw the middle frame of the stretch with numbered regions."""
    frame = stretch.frames[len(stretch.frames) // 2]
    rows, cols = frame.pixels.shape
    step = max(1, -(-max(rows, cols) // 1600))
    figure = Figure(figsize=(WIDTH_INCHES, float(np.clip(WIDTH_INCHES * rows / cols + 0.5, 1.4, 7.5))))
    axes = figure.add_subplot()
    left, top = frame.origin
    extent = (left - 0.5, left + cols - 0.5, top + rows - 0.5, top - 0.5)
    axes.imshow(frame.pixels[::step, ::step], cmap="gray", vmin=0, vmax=_white(frame), extent=extent)
    for number, report in enumerate(reports, 1):
        _mark(axes, report, number, report.region.box_at(len(stretch.frames) // 2, len(stretch.frames)))
    axes.set(xlim=extent[:2], ylim=extent[2:], xlabel="x (px)", ylabel="y (px)")
    axes.set_title(f"frame {frame.index}", fontsize=10)
    axes.grid(False)
    return figure


def _mark(axes: Axes, report: RegionReport, number: int, box: Window) -> None:
    """Draw the outline and the label of a region: green if decoded, orange with a remedy, red if like an array."""
    like = RED if report.like_array else GRAY
    colour = GREEN if report.array is not None else ORANGE if report.remedy is not None else like
    x, y, width, height = box
    for line, paint in ((3.2, "white"), (1.6, colour)):
        outline = Rectangle((x - 2.5, y - 2.5), width + 4, height + 4, fill=False, edgecolor=paint, linewidth=line)
        axes.add_patch(outline)
    kind = report.causes[0].kind if report.causes else ""
    name = f"array {report.array.packet.identity}" if report.array is not None else kind
    # the label stays within the frame
    is_right, is_lower = x > np.mean(axes.get_xlim()), y > np.mean(axes.get_ylim())
    axes.annotate(
        f"{number}: {name}", (x + width if is_right else x, y if is_lower else y + height),
        xytext=(-3 if is_right else 3, 6 if is_lower else -6), textcoords="offset points", fontsize=9, color="white",
        ha="right" if is_right else "left", va="bottom" if is_lower else "top",
        bbox={"boxstyle": "round,pad=0.2", "fc": colour, "ec": "white", "lw": 0.6},
    )  # fmt: skip


def region_picture(stretch: Stretch, report: RegionReport) -> Figure:
    """Draw two frames of a region, the alternation, the sum, and the brightness over the stretch."""
    frames, region = stretch.frames, report.region
    count = len(frames)

    def power(k: int) -> float:
        return float(np.square(alternation(frames[k : k + 4], region.box_at(k + 1.5, count))).mean())

    k = max(range(0, count - 3, max(1, count // 128)), key=power)
    window = region.box_at(k + 1.5, count, max(1.8, 24 / region.side))
    first, second = (cut_out(frame, window) for frame in frames[k : k + 2])
    change = alternation(frames[k : k + 4], window)
    figure = Figure(figsize=(WIDTH_INCHES, 4.6))
    grid = figure.add_gridspec(2, 4, height_ratios=(1.5, 1))
    white, swing = _white(frames[k], float(max(first.max(), second.max()))), float(np.abs(change).max())
    images: list[tuple[NDArray[Any], str, str, float, float]] = [
        (first, f"frame {frames[k].index}", "gray", 0, white),
        (second, f"frame {frames[k + 1].index}", "gray", 0, white),
        (change, "alternation", "RdBu_r", -swing, swing),
        (first + second, "sum of both", "gray", 0, 2 * white),
    ]
    for column, (image, title, colours, low, high) in enumerate(images):
        axes = figure.add_subplot(grid[0, column])
        axes.imshow(image, cmap=colours, vmin=low, vmax=max(high, low + 1e-6))
        axes.set_title(title, fontsize=9)
        axes.set_axis_off()
    axes, numbers = figure.add_subplot(grid[1, :]), np.array([frame.index for frame in frames])
    axes.plot(numbers, region.brightness, color=BLUE, lw=0.9, label="mean gray level of the region")
    axes.axvspan(numbers[k] - 0.5, numbers[k + 1] + 0.5, color=ORANGE, alpha=0.35, lw=0, label="the frames above")
    if report.header is not None and report.header.starts and report.like_array:
        step = max(report.rate.frames, 1.0) if report.rate is not None else 1.0
        starts = [numbers[min(round(start * step), count - 1)] for start in report.header.starts]
        axes.vlines(starts, *axes.get_ylim(), color=GREEN, lw=1.1, ls="--", label="a header begins")
    axes.set(xlabel="frame", ylabel="gray level", xlim=(numbers[0], max(numbers[-1], numbers[0] + 1)))
    axes.legend(fontsize=8, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=3)
    return figure


def noise_picture(noise: NoiseEstimate) -> Figure:
    """Draw the variance of static pixels against gray level."""
    figure = Figure(figsize=(5.6, 3.4))
    axes = figure.add_subplot()
    levels, variances = np.array(noise.points).T
    axes.plot(levels, variances, "o", color=BLUE, ms=4, label="static blocks")
    if noise.gain_dn_per_e is not None:
        ends = np.array([0.0, levels.max()])
        axes.plot(ends, [noise.variance_at(level) or 0.0 for level in ends], color=DARK_GRAY, lw=1, label="fitted line")
    axes.set(xlabel="gray level", ylabel="variance of a pixel", ylim=(0, 1.15 * variances.max()))
    axes.legend(fontsize=8, loc="lower right")
    return figure


def _white(frame: Frame, brightest: float | None = None) -> float:
    """Return the gray level of white: dark films are brightened."""
    limit = float(np.quantile(frame.pixels, 0.999)) if brightest is None else brightest
    return max(min(1.2 * limit, float(frame.full_scale)), 0.04 * frame.full_scale)


@styled
def write_page(path: Path, found: Findings) -> None:
    """Write the page atomically."""
    page = Report(f"Probe of {shown_name(found.path)}")
    page.text(_verdict(found))
    if found.advice:
        page.heading("What to change")
        page.table(["advice"], [[line] for line in found.advice], prose=True)
    page.heading("The film")
    causes = [f"cause: {cause_words(cause)}" for cause in found.causes]
    rows = [line.partition(": ") for line in (*list(film_lines(found))[1:], *causes)]
    page.table(["", size_words(found)], [row[::2] for row in rows], prose=True)
    for array in found.arrays:
        head, *lines = array_lines(array)
        page.table([head], [[line.strip()] for line in lines], prose=True)
    if found.stretch is not None:
        page.heading("Where something blinks")
        if found.regions:
            _write_regions(page, found.stretch, found.regions)
        else:
            page.figure(frame_picture(found.stretch, ()), "A frame of the film; no region blinks.")
    if found.noise.points:
        page.heading("Noise")
        page.figure(noise_picture(found.noise), f"Noise by photon transfer: {noise_words(found.noise)}.")
    page.write(path)


def _verdict(found: Findings) -> str:
    if found.read:
        packets = [array.packet for array in found.arrays]
        names = ", ".join(f"array {packet.identity} ({packet.orientation})" for packet in packets)
        return f"Read with the settings as they are: {names}."
    if found.error:
        return f"No array was read; the receiver reports an error: {found.error}."
    if found.regions:
        return f"No array was read. {counted(found.regions_in_all, 'region')} with blinking or motion; reasons below."
    return "No array was read, and no region blinks."


def _write_regions(page: Report, stretch: Stretch, reports: Sequence[RegionReport]) -> None:
    first, last = stretch.frames[0].index, stretch.frames[-1].index
    page.figure(frame_picture(stretch, reports), f"Strongest regions in frames {first} to {last}, and the causes.")
    for number, report in enumerate(reports, 1):
        page.heading(f"Region {number}: {report.causes[0].kind if report.causes else ''}")
        for cause in report.causes:
            page.text(cause_words(cause))
        for line in would_be_lines(report):
            page.text(f"{line.strip()}.", note=True)
        rate = f"; a pattern lasts {report.rate.frames:.2f} frames" if report.rate else ""
        caption = f"Region {number}, {place(report)}{rate}. Two frames, alternation, sum; below, the brightness."
        page.figure(region_picture(stretch, report), caption)
