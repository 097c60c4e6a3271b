"""What was found as one page that fetches nothing: pictures, tables, and what to change."""

from pathlib import Path

from heliograph.base.files import shown_name
from heliograph.base.words import counted
from heliograph.experiments.report import Report
from heliograph.probe import pictures
from heliograph.probe.causes import RegionSeen
from heliograph.probe.film import Findings
from heliograph.probe.words import array_lines, cause_words, lines, noise_words, place, would_be_lines
from heliograph.signal.settings import LAYERS


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
        page.figure(pictures.frame_with_regions(found.stretch, ()), "A frame from the film. Nothing in it blinks.")
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
    page.figure(pictures.frame_with_regions(stretch, found.regions), caption)
    head = ["region", "place (px)", "size (px)", "speed (px a frame)", "contrast", "frames a pattern", "header"]
    page.table(head, [_row(number, seen) for number, seen in enumerate(found.regions, 1)])
    for number, seen in enumerate(found.regions, 1):
        page.heading(f"Region {number}: {seen.causes[0].kind if seen.causes else ''}")
        for cause in seen.causes:
            page.text(cause_words(cause))
        for line in would_be_lines(seen):
            page.text(f"{line.strip()}.", note=True)
        caption = f"Region {number}, {place(seen)}. Two frames, what alternates, their sum; below, its brightness."
        page.figure(pictures.region_picture(stretch, seen), caption)


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
    page.figure(pictures.noise_picture(found.noise), f"Noise by photon transfer: {words}.")
