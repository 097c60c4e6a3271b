"""HTML page of a diagnosis: pictures, tables and remedies."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from heliograph.base.files import shown_name
from heliograph.base.frames import Frame
from heliograph.experiments.plots import BLUE, DARK_GRAY, GRAY, GREEN, ORANGE, RED, tidy
from heliograph.experiments.report import Report
from heliograph.probe.activity import Stretch
from heliograph.probe.causes import RegionReport
from heliograph.probe.film import Findings
from heliograph.probe.noise import NoiseEstimate
from heliograph.probe.regions import alternation
from heliograph.probe.words import cause_words, lines, noise_words, place, would_be_lines
from heliograph.receive.geometry.window import Window, cut_out

WIDTH_INCHES = 11.0


def _colour(report: RegionReport) -> str:
    """Colour of a region: green for decoded, orange for decoded with a remedy, red for like an array."""
    if report.array is not None:
        return GREEN
    if report.remedy is not None:
        return ORANGE
    return RED if report.like_array else GRAY


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
        _mark(axes, report, number, len(stretch.frames), (left, top, cols, rows))
    axes.set(xlim=extent[:2], ylim=extent[2:], xlabel="x (px)", ylabel="y (px)")
    axes.set_title(f"frame {frame.index}", fontsize=10)
    figure.tight_layout()
    return figure


def _mark(axes: Axes, report: RegionReport, number: int, frames: int, frame: Window) -> None:
    """Draw the outline and the label of a region, within the frame."""
    left, top, cols, rows = frame
    x, y, width, height = report.region.box_at(frames // 2, frames)
    pad = max(2.0, 0.006 * cols)
    x0, x1 = max(x - pad, left), min(x + width - 1 + pad, left + cols - 1)
    y0, y1 = max(y - pad, top), min(y + height - 1 + pad, top + rows - 1)
    colour = _colour(report)
    for line, paint in ((3.2, "white"), (1.6, colour)):
        axes.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], color=paint, lw=line)
    kind = report.causes[0].kind if report.causes else ""
    name = f"array {report.array.identity}" if report.array is not None else kind
    is_right, is_upper = x1 > left + 0.85 * cols, y0 < top + 0.15 * rows
    axes.annotate(
        f"{number}: {name}", (x1, y1 if is_upper else y0), xytext=(-3 if is_right else 3, -3 if is_upper else 3),
        textcoords="offset points", fontsize=9, color="white", ha="right" if is_right else "left",
        va="top" if is_upper else "bottom",
        bbox={"boxstyle": "round,pad=0.2", "fc": colour, "ec": "white", "lw": 0.6},
    )  # fmt: skip


def region_picture(stretch: Stretch, report: RegionReport) -> Figure:
    """Draw two frames of a region, the alternation, the sum, and the brightness over the stretch."""
    frames, region = stretch.frames, report.region
    count = len(frames)

    def alternating(k: int) -> float:
        return float(np.square(alternation(frames[k : k + 4], region.box_at(k + 1.5, count))).mean())

    k = max(range(0, count - 3, max(1, count // 128)), key=alternating)
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
        axes.imshow(image, cmap=colours, vmin=low, vmax=max(high, low + 1e-6), interpolation="nearest")
        axes.set_title(title, fontsize=9)
        axes.set_axis_off()
    _draw_brightness(figure.add_subplot(grid[1, :]), frames, report, k)
    figure.tight_layout()
    return figure


def _draw_brightness(axes: Axes, frames: Sequence[Frame], report: RegionReport, k: int) -> None:
    numbers = np.array([frame.index for frame in frames])
    axes.plot(numbers, report.region.brightness, color=BLUE, lw=0.9, label="mean gray level of the region")
    axes.axvspan(numbers[k] - 0.5, numbers[k + 1] + 0.5, color=ORANGE, alpha=0.35, lw=0, label="the frames above")
    if report.header is not None and report.like_array:
        step = report.rate.frames if report.rate is not None and report.rate.frames > 1.02 else 1.0
        for number, start in enumerate(report.header.starts):
            at = numbers[min(round(start * step), len(numbers) - 1)]
            axes.axvline(at, color=GREEN, lw=1.1, ls="--", label="a header begins" if number == 0 else None)
    tidy(axes)
    axes.set(xlabel="frame", ylabel="gray level", xlim=(numbers[0], max(numbers[-1], numbers[0] + 1)))
    axes.legend(frameon=False, fontsize=8, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=3)


def noise_picture(noise: NoiseEstimate) -> Figure:
    """Draw the variance of static pixels against gray level."""
    figure = Figure(figsize=(5.6, 3.4))
    axes = figure.add_subplot()
    points = np.array(noise.points)
    axes.plot(points[:, 0], points[:, 1], "o", color=BLUE, ms=4, label="static blocks")
    if noise.line is not None:
        x = np.array([0.0, points[:, 0].max()])
        axes.plot(x, noise.line[0] + noise.line[1] * x, color=DARK_GRAY, lw=1, label="fitted line")
        axes.set_xlim(left=0)
    axes.set(xlabel="gray level", ylabel="variance of a pixel", ylim=(0, 1.15 * points[:, 1].max()))
    axes.legend(frameon=False, fontsize=8, loc="lower right")
    tidy(axes)
    figure.tight_layout()
    return figure


def _white(frame: Frame, brightest: float | None = None) -> float:
    """Return the gray level of white: dark films are brightened."""
    limit = float(np.quantile(frame.pixels, 0.999)) if brightest is None else brightest
    return max(min(1.2 * limit, float(frame.full_scale)), 0.04 * frame.full_scale)


def write_page(path: Path, found: Findings) -> None:
    """Write the page atomically."""
    page = Report(f"Probe of {shown_name(found.path)}")
    page.text(_verdict(found))
    if found.advice:
        page.heading("What to change")
        page.table(["advice"], [[line] for line in found.advice], prose=True)
    page.heading("The film")
    page.code("\n".join(lines(found)))
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
        names = ", ".join(f"array {array.identity} ({array.orientation})" for array in found.arrays)
        return f"Read with the settings as they are: {names}."
    if found.regions:
        single = "One region blinks or moves"
        several = f"{found.regions_in_all} regions blink or move" if found.regions_in_all > 1 else single
        return f"No array was read. {several}; the reasons are below."
    return "No array was read, and no region blinks."


def _write_regions(page: Report, stretch: Stretch, reports: Sequence[RegionReport]) -> None:
    first, last = stretch.frames[0].index, stretch.frames[-1].index
    page.figure(frame_picture(stretch, reports), f"Strongest regions in frames {first} to {last}, and the causes.")
    head = ["region", "place (px)", "size (px)", "speed (px a frame)", "contrast", "frames a pattern", "header"]
    page.table(head, [_row(number, report) for number, report in enumerate(reports, 1)])
    for number, report in enumerate(reports, 1):
        page.heading(f"Region {number}: {report.causes[0].kind if report.causes else ''}")
        for cause in report.causes:
            page.text(cause_words(cause))
        for line in would_be_lines(report):
            page.text(f"{line.strip()}.", note=True)
        caption = f"Region {number}, {place(report)}. Two frames, alternation, sum; below, the brightness."
        page.figure(region_picture(stretch, report), caption)


def _row(number: int, report: RegionReport) -> list[str]:
    region, scored = report.region, report.array if report.array is not None else report.header
    return [
        str(number), f"{region.x:.0f}, {region.y:.0f}", f"{region.width:.1f} x {region.height:.1f}",
        f"{region.speed_px:.2f}", f"{region.contrast:.3f}", f"{report.rate.frames:.2f}" if report.rate else "-",
        "-" if scored is None else f"{scored.score:.2f}",
    ]  # fmt: skip
