"""What was found, in words for a terminal, and as plain values for JSON."""

from collections.abc import Iterator
from math import isfinite
from typing import Any

from heliograph.base.errors import printable
from heliograph.base.words import counted
from heliograph.probe.arrays import ArraySeen, Clock
from heliograph.probe.causes import Cause, RegionSeen
from heliograph.probe.film import Findings
from heliograph.probe.noise import NoiseFound
from heliograph.probe.reach import Reach
from heliograph.probe.trials import options

UNTOLD = {
    "one level": "all that stands still has about one gray level",
    "moving": "nothing stands still",
    "wiped": "compression has wiped the noise out",
    "no slope": "the noise is about the same at all gray levels",
    "few": "too little stands still between black and full scale",
}
"""Why gain and dark noise are not told."""


def lines(found: Findings) -> Iterator[str]:
    """All that was found, line by line."""
    size = f"{found.width}x{found.height} px, {found.bits} bits"
    yield f"{printable(found.path)}: {counted(found.times.count, 'frame')} of {size}"
    yield f"stamps: {_stamps(found)}"
    yield f"light: {_light(found)}"
    yield f"levels: {_levels(found)}"
    yield f"noise: {noise_words(found.noise)}"
    for array in found.arrays:
        yield from array_lines(array)
    for number, seen in enumerate(found.regions, 1):
        yield f"region {number}: {place(seen)}"
        yield from would_be_lines(seen)
        for cause in seen.causes:
            yield f"  {cause_words(cause)}"
    if found.regions_in_all > len(found.regions):
        yield f"{found.regions_in_all} regions in all blink or move; those that do so most are told"
    for cause in found.causes:
        yield f"film: {cause_words(cause)}"
    if found.error:
        yield f"receiver: {found.error}"
    if not found.read:
        near = any(seen.like_array for seen in found.regions)
        yield "no array was read with these settings" if near else "no array found"
    if found.advice:
        yield "what to change:"
        yield from (f"  - {line}" for line in found.advice)


def in_short(found: Findings) -> Iterator[str]:
    """Why no array was found, in few lines."""
    for cause in found.causes:
        yield f"film: {cause_words(cause)}"
    # most regions that `in_short` tells of
    for number, seen in enumerate(found.regions[:3], 1):
        yield f"region {number}: {place(seen)}: {cause_words(seen.causes[0])}" if seen.causes else place(seen)
    yield from (f"  - {line}" for line in found.advice)


def in_sentences(found: Findings) -> Iterator[str]:
    """Why nothing is read, for a page: a line for each cause, with all that helps against it."""
    for cause in [*(one for seen in found.regions for one in seen.causes), *found.causes]:
        helps = " ".join(f"{line[0].upper()}{line[1:]}." for line in cause.advice)
        yield f"{cause.kind.capitalize()}: {cause.why}. {helps}".rstrip()


def place(seen: RegionSeen) -> str:
    """Where a region is, its size, contrast and speed."""
    region = seen.region
    moving = f"moves by {region.speed_px:.2f} px a frame" if region.speed_px >= 0.005 else "still"
    return (
        f"at ({region.x:.0f}, {region.y:.0f}), {region.width:.1f} x {region.height:.1f} px, contrast "
        f"{region.contrast:.2f}, {moving}"
    )


def cause_words(cause: Cause) -> str:
    """A cause in a sentence; it is called proven where codewords were read once it was changed."""
    proven = " (tried: read then)" if cause.proven and cause.kind != "array" else ""
    return f"{cause.why if cause.kind == 'array' else f'{cause.kind}: {cause.why}'}{proven}"


def noise_words(noise: NoiseFound) -> str:
    """Noise and gain in a sentence."""
    if noise.gain is not None and noise.dark_e is not None:
        return (
            f"{noise.gain:.3g} gray levels an electron (standard error {noise.gain_error:.1g}), {noise.dark_e:.0f} "
            "electrons without light, if black is 0"
        )
    untold = UNTOLD.get(noise.untold, "too few frames")
    if noise.level is None or noise.deviation is None:
        return f"not told: {untold}"
    return f"{noise.deviation:.2f} gray levels at level {noise.level:.0f}; the gain is not told, as {untold}"


def array_lines(array: ArraySeen) -> Iterator[str]:
    """An array that was read, line by line."""
    away = " to ".join(dict.fromkeys(f"{d:.1f} m" for d in (array.first_distance_m, array.last_distance_m)))
    yield (
        f"array {array.identity}: {array.orientation}, {counted(array.packets, 'packet')}, "
        f"frames {array.first_frame} to "
        f"{array.last_frame}, {away} away by the settings' optics"
    )
    yield (
        f"  {array.pitch_px:.2f} px from LED to LED, contrast {array.contrast:.2f}, blur {array.blur_px:.2f} px, "
        f"correlation with its header {array.score:.2f}"
    )
    read = (f"{name} {array.ok[name]} of {array.ok[name] + array.failed[name]}" for name in array.ok)
    yield f"  codewords read: {', '.join(read)}"
    if array.clock is not None:
        yield f"  {clock_words(array.clock)}"
    if array.exposure is not None:
        low, high = array.exposure
        yield f"  exposure by the light: {low:.2f} to {high:.2f} of a frame period"
    elif array.clock is not None:
        yield "  exposure by the light: not told, as frames show the same parts of patterns"
    if array.noise is not None:
        lit, beside = (0.5 * array.noise.lit) ** 0.5, (0.5 * array.noise.dark) ** 0.5
        inside = "not told within, where some are at full scale" if array.clipped else f"{lit:.2f} gray levels within"
        yield f"  noise of a pixel: {inside}, {beside:.2f}{' gray levels' if array.clipped else ''} beside it"
    noise = "the noise beside it" if array.clipped else "noise"
    for reach in array.reach:
        yield f"  {reach.receiver} expected to read {reach_words(reach)} (an estimate by light, blur and {noise})"


def would_be_lines(seen: RegionSeen) -> Iterator[str]:
    """A region that is not read as the array that it would be, line by line; nothing where it shows too little."""
    array = seen.would_be
    if array is None:
        return
    yield (
        f"  as an array: {array.pitch_px:.2f} px from LED to LED, contrast {array.contrast:.2f}, blur "
        f"{array.blur_px:.2f} px"
    )
    if array.clock is not None:
        yield f"  {clock_words(array.clock)}"
    for reach in array.reach:
        yield f"  {reach.receiver} would read {reach_words(reach)} (an estimate by light, noise and blur)"


def clock_words(clock: Clock) -> str:
    """The light's clock in a sentence."""
    text = f"patterns begin {clock.phase:+.2f} of a pattern after frames"
    if clock.rate_ppm is None:
        return f"{text}; the light's rate is not told"
    longer = "longer" if clock.rate_ppm >= 0 else "shorter"
    error = f"(standard error {clock.rate_error_ppm:.0f})"
    return f"{text}, and last {abs(clock.rate_ppm):.0f} ppm {longer} than the settings say {error}"


def reach_words(reach: Reach) -> str:
    """How far layers are expected to be read, in words."""
    return ", ".join(f"{layer} {_distance(distance)}" for layer, distance in reach.distance_m.items())


def _distance(distance_m: float) -> str:
    if not isfinite(distance_m):
        return "at all distances"
    return f"to {distance_m:.0f} m" if distance_m > 0 else "nowhere"


def _stamps(found: Findings) -> str:
    times = found.times
    claimed = "" if abs(times.claimed_hz / times.rate_hz - 1) < 1e-3 else f" ({times.claimed_hz:.6g} claimed)"
    every = f", every {times.every}th of the camera's" if times.every > 1 else ""
    jitter = f"jitter {1e6 * times.jitter_s:.1f} us" if times.jitter_s >= 5e-8 else "no jitter"
    lost = f"{times.lost} lost at {counted(times.gaps, 'place')}" if times.lost else "none lost"
    twice = f"{times.repeated} repeated" if times.repeated else "none repeated"
    return f"{times.rate_hz:.6g} frames a second{claimed}{every}, {jitter}, {lost}, {twice}"


def _light(found: Findings) -> str:
    rate, asked = found.rate, found.asked
    if rate is None:
        return "not asked, as an array is read" if found.read else "no patterns with their inverses are seen"
    camera_hz = float(f"{rate.frames / asked.signal.pattern_period_s:.3g}")
    return (
        f"a pattern lasts {rate.frames:.2f} frames; with these stamps the settings make it "
        f"{asked.frames_a_pattern:.2f}; if it lasts {1e3 * asked.signal.pattern_period_s:.3g} ms, the camera takes "
        f"about {camera_hz:g} frames a second"
    )


def _levels(found: Findings) -> str:
    levels = found.levels
    parts = ", ".join(f"{level:.0f} ({'median' if p == 50 else f'{p} %'})" for p, level in levels.percentiles.items())
    full = (
        f"{100 * levels.at_full_scale:.3g} % of the pixels at full scale"
        if levels.at_full_scale
        else "none at full scale"
    )
    return f"{parts}, {levels.brightest} at most, of {levels.full_scale}; {full}"


def as_mapping(found: Findings) -> dict[str, Any]:
    """All that was found as plain values, for JSON."""
    times, levels, noise, rate = found.times, found.levels, found.noise, found.rate
    return {
        "film": found.path,
        "array_read": found.read,
        "width": found.width,
        "height": found.height,
        "bits": found.bits,
        "frames": {
            "count": times.count, "rate_hz": _round(times.rate_hz), "claimed_hz": _round(times.claimed_hz),
            "jitter_s": _round(times.jitter_s), "every": times.every, "lost": times.lost, "gaps": times.gaps,
            "repeated": times.repeated,
        },
        "light": None if rate is None else {
            "frames_a_pattern": _round(rate.frames), "explained": _round(rate.explained),
            "patterns_hz": _round(times.rate_hz / rate.frames),
            "camera_hz": _round(rate.frames / found.asked.signal.pattern_period_s),
        },
        "levels": {
            "full_scale": levels.full_scale, "ceiling": levels.ceiling, "brightest": levels.brightest,
            "percentiles": {str(p): level for p, level in levels.percentiles.items()},
            "at_full_scale": _round(levels.at_full_scale), "at_zero": _round(levels.at_zero),
        },
        "noise": {
            "gain_dn_per_e": _round(noise.gain), "gain_error": _round(noise.gain_error), "dark_e": _round(noise.dark_e),
            "level": _round(noise.level), "deviation": _round(noise.deviation), "untold": noise.untold,
        },
        "arrays": [_array(one) for one in found.arrays],
        "regions": [_region(one) for one in found.regions],
        "regions_in_all": found.regions_in_all,
        "causes": [_cause(one) for one in found.causes],
        "receiver_error": found.error,
        "advice": found.advice,
    }  # fmt: skip


def _array(array: ArraySeen) -> dict[str, Any]:
    clock, noise = array.clock, array.noise
    names = ("first_distance_m", "last_distance_m", "x", "y", "pitch_px", "blur_px", "contrast", "score")
    return {
        "id": array.identity, "orientation": array.orientation, "packets": array.packets,
        "first_frame": array.first_frame, "last_frame": array.last_frame,
        **{name: _round(getattr(array, name)) for name in names},
        "codewords": {name: {"ok": array.ok[name], "failed": array.failed[name]} for name in array.ok},
        "clock": None if clock is None else {
            "phase_patterns": _round(clock.phase), "rate_ppm": _round(clock.rate_ppm),
            "rate_error_ppm": _round(clock.rate_error_ppm),
        },
        "noise": None if noise is None else {
            "lit": None if array.clipped else _round(noise.lit), "dark": _round(noise.dark),
        },
        "exposure_frames": None if array.exposure is None else [*map(_round, array.exposure)],
        "expected_m": _expected(array.reach),
    }  # fmt: skip


def _expected(reaches: tuple[Reach, ...]) -> dict[str, Any]:
    return {
        one.receiver: {name: _round(d) if isfinite(d) else None for name, d in one.distance_m.items()}
        for one in reaches
    }


def _region(seen: RegionSeen) -> dict[str, Any]:
    region, header, rate = seen.region, seen.header, seen.rate
    names = ("x", "y", "width", "height", "contrast", "saturated", "blinks")
    return {
        **{name: _round(getattr(region, name)) for name in names},
        "speed_px": [_round(v) for v in region.speed],
        "at_border": region.at_border,
        "pattern_part": _round(seen.pattern_part),
        "frames_a_pattern": None if rate is None else _round(rate.frames),
        "lamp_frames": _round(seen.lamp_frames),
        "header": None if header is None else {
            "score": _round(header.score), "size_px": _round(header.size_px), "blur_px": _round(header.fit.pose.blur),
            "pairs": header.pairs, "period_frames": header.period,
            "may_be": [{"id": number, "orientation": str(seen_as)} for number, seen_as in header.hypotheses],
        },
        "would_be": None if seen.would_be is None else {
            **{name: _round(getattr(seen.would_be, name)) for name in ("pitch_px", "blur_px", "contrast")},
            "phase_patterns": None if seen.would_be.clock is None else _round(seen.would_be.clock.phase),
            "expected_m": _expected(seen.would_be.reach),
        },
        "array": None if seen.array is None else seen.array.identity,
        "reads_with": None if seen.found is None else [*options(seen.found.changes)],
        "causes": [_cause(one) for one in seen.causes],
    }  # fmt: skip


def _cause(cause: Cause) -> dict[str, Any]:
    return {"kind": cause.kind, "why": cause.why, "advice": [*cause.advice], "proven": cause.proven}


def _round(value: float | None) -> float | None:
    """A number of five digits."""
    return None if value is None else float(f"{value:.5g}")
