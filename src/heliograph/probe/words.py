"""Diagnosis of a film as text for a terminal, and as plain values for JSON."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from math import isfinite
from typing import Any

from heliograph.base.errors import counted, printable
from heliograph.probe.arrays import ArrayReport, Clock
from heliograph.probe.causes import Cause, RegionReport
from heliograph.probe.film import Findings
from heliograph.probe.noise import NoiseEstimate
from heliograph.probe.trials import options
from heliograph.receive.geometry.pose import Pose


def lines(found: Findings) -> Iterator[str]:
    """Yield the complete diagnosis line by line."""
    yield from film_lines(found)
    for array in found.arrays:
        yield from array_lines(array)
    for number, report in enumerate(found.regions, 1):
        yield f"region {number}: {place(report)}"
        yield from would_be_lines(report)
        yield from (f"  {cause_words(cause)}" for cause in report.causes)
    if found.regions_in_all > len(found.regions):
        yield f"{found.regions_in_all} regions blink or move; the strongest are listed"
    yield from (f"film: {cause_words(cause)}" for cause in found.causes)
    if found.error:
        yield f"receiver: {found.error}"
    if not found.read:
        is_near = any(report.like_array for report in found.regions)
        yield "no array was read with these settings" if is_near else "no array found"
    if found.advice:
        yield "what to change:"
        yield from (f"  - {line}" for line in found.advice)


def in_short(found: Findings) -> Iterator[str]:
    """Yield the causes and remedies in a few lines."""
    yield from (f"film: {cause_words(cause)}" for cause in found.causes)
    for number, report in enumerate(found.regions[:3], 1):
        text = place(report)
        yield f"region {number}: {text}: {cause_words(report.causes[0])}" if report.causes else text
    yield from (f"  - {line}" for line in found.advice)


def in_sentences(found: Findings) -> Iterator[str]:
    """Yield a line for each cause with all remedies, for a web page."""
    for cause in [*(cause for report in found.regions for cause in report.causes), *found.causes]:
        remedies = " ".join(f"{line[0].upper()}{line[1:]}." for line in cause.advice)
        yield f"{cause.kind.capitalize()}: {cause.why}. {remedies}".rstrip()


def film_lines(found: Findings) -> Iterator[str]:
    """Describe size, time stamps, light, levels and noise of a film, each with a name and a colon."""
    times, levels, rate, setup = found.times, found.levels, found.rate, found.setup
    yield f"{printable(found.path)}: {size_words(found)}"
    claimed = "" if abs(times.claimed_hz / times.rate_hz - 1) < 1e-3 else f" ({times.claimed_hz:.6g} claimed)"
    every = f", every {times.every}th of the camera's" if times.every > 1 else ""
    jitter = f"jitter {1e6 * times.jitter_s:.1f} us" if times.jitter_s >= 5e-8 else "no jitter"
    lost = f"{times.lost} lost at {counted(times.gaps, 'place')}" if times.lost else "none lost"
    repeated = f"{times.repeated or 'none'} repeated"
    yield f"stamps: {times.rate_hz:.6g} frames a second{claimed}{every}, {jitter}, {lost}, {repeated}"
    if rate is not None:
        period_s = setup.signal.pattern_period_s
        camera_hz = float(f"{rate.frames / period_s:.3g}")
        yield (
            f"light: a pattern lasts {rate.frames:.2f} frames, {setup.frames_a_pattern:.2f} by stamps and settings; if "
            f"it lasts {1e3 * period_s:.3g} ms, the camera takes about {camera_hz:g} frames a second"
        )
    else:
        unknown = "not measured, as an array is read" if found.read else "no patterns with their inverses are visible"
        yield f"light: {unknown}"
    parts = [f"{level:.0f} ({'median' if p == 50 else f'{p} %'})" for p, level in levels.percentiles.items()]
    clipped = f"{100 * levels.at_full_scale:.3g} % of the pixels" if levels.at_full_scale else "none"
    yield f"levels: {', '.join(parts)}, {levels.brightest} at most, of {levels.full_scale}; {clipped} at full scale"
    yield f"noise: {noise_words(found.noise)}"


def size_words(found: Findings) -> str:
    """Describe number and size of the frames."""
    return f"{counted(found.times.count, 'frame')} of {found.width}x{found.height} px, {found.bits} bits"


def place(report: RegionReport) -> str:
    """Describe position, size, contrast and speed of a region."""
    region = report.region
    speed = f"moves by {region.speed_px:.2f} px a frame" if region.speed_px >= 0.005 else "still"
    size = f"{region.width:.1f} x {region.height:.1f} px"
    return f"at ({region.x:.0f}, {region.y:.0f}), {size}, contrast {region.contrast:.2f}, {speed}"


def cause_words(cause: Cause) -> str:
    """Describe a cause."""
    if cause.kind == "array":
        return cause.why
    return f"{cause.kind}: {cause.why}{' (tried: read then)' if cause.proven else ''}"


def noise_words(noise: NoiseEstimate) -> str:
    """Describe noise and gain."""
    if noise.gain_dn_per_e is not None:
        return (
            f"{noise.gain_dn_per_e:.3g} gray levels an electron (standard error {noise.gain_error:.1g}), "
            f"{noise.dark_e:.0f} electrons in the dark, if black is 0"
        )
    obstacle = {
        "one level": "all static parts have about one gray level",
        "moving": "no part of the image is static",
        "wiped": "compression has wiped the noise out",
        "no slope": "the noise is about the same at all gray levels",
        "few": "too few static parts lie between black and full scale",
    }[noise.untold]
    if noise.level is None:
        return f"unknown: {obstacle}"
    return f"{noise.deviation:.2f} gray levels at level {noise.level:.0f}; the gain is unknown, as {obstacle}"


def array_lines(array: ArrayReport) -> Iterator[str]:
    """Describe a decoded array line by line."""
    packet, tally = array.packet, array.tally
    away = " to ".join(dict.fromkeys(f"{d:.1f} m" for d in (tally.first_distance_m, tally.last_distance_m)))
    frames = f"{counted(tally.packets, 'packet')}, frames {tally.first_frame} to {tally.last_frame}"
    yield f"array {packet.identity}: {packet.orientation}, {frames}, {away} away by the settings' optics"
    yield f"  {_optics_words(packet.pose, array.contrast)}, correlation with the header {array.score:.2f}"
    read = (f"{name} {layer.ok} of {layer.ok + layer.failed}" for name, layer in tally.layers.items())
    yield f"  codewords read: {', '.join(read)}"
    if array.clock is not None:
        yield f"  {clock_words(array.clock)}"
    if array.exposure is not None:
        yield "  exposure by the light: {:.2f} to {:.2f} of a frame period".format(*array.exposure)
    elif array.clock is not None:
        yield "  exposure by the light: unknown, as frames show the same parts of patterns"
    if array.noise is not None:
        lit, dark = (f"{(0.5 * variance) ** 0.5:.2f} gray levels" for variance in (array.noise.lit, array.noise.dark))
        inside = "unknown within, as some are at full scale" if array.clipped else f"{lit} within"
        yield f"  noise of a pixel: {inside}, {dark} outside"
    noise = "the noise outside" if array.clipped else "noise"
    for receiver, distances_m in array.reach.items():
        yield f"  {receiver} expected to read {reach_words(distances_m)} (an estimate by light, blur and {noise})"


def would_be_lines(report: RegionReport) -> Iterator[str]:
    """Describe a region as an array line by line."""
    array = report.would_be
    if array is None:
        return
    yield f"  as an array: {_optics_words(array.pose, array.contrast)}"
    if array.clock is not None:
        yield f"  {clock_words(array.clock)}"
    for receiver, distances_m in array.reach.items():
        yield f"  {receiver} would read {reach_words(distances_m)} (an estimate by light, noise and blur)"


def _optics_words(pose: Pose, contrast: float) -> str:
    return f"{pose.pitch:.2f} px from LED to LED, contrast {contrast:.2f}, blur {pose.blur:.2f} px"


def clock_words(clock: Clock) -> str:
    """Describe the clock of the light."""
    phase = round(clock.phase_patterns, 2) + 0.0  # no negative zero
    text = f"patterns begin {phase:+.2f} of a pattern after frames"
    if clock.rate_ppm is None:
        return f"{text}; the rate of the light is unknown"
    longer = "longer" if clock.rate_ppm >= 0 else "shorter"
    error = f"(standard error {clock.rate_error_ppm:.0f})"
    return f"{text}, and last {abs(clock.rate_ppm):.0f} ppm {longer} than in the settings {error}"


def reach_words(distances_m: Mapping[str, float]) -> str:
    """Describe the reach of each layer."""
    return ", ".join(f"{layer} {_end_words(end_m)}" for layer, end_m in distances_m.items())


def _end_words(end_m: float) -> str:
    if not isfinite(end_m):
        return "at all distances"
    return f"to {end_m:.0f} m" if end_m > 0 else "nowhere"


def as_mapping(found: Findings) -> dict[str, Any]:
    """Return the diagnosis as plain values for JSON."""
    rate = found.rate
    return _plain({
        "film": found.path,
        "array_read": found.read,
        **_fields(found, "width", "height", "bits"),
        "frames": asdict(found.times),
        "light": rate and {
            "frames_a_pattern": rate.frames, "explained": rate.explained,
            "patterns_hz": found.times.rate_hz / rate.frames,
            "camera_hz": rate.frames / found.setup.signal.pattern_period_s,
        },
        "levels": asdict(found.levels),
        "noise": _fields(found.noise, "gain_dn_per_e", "gain_error", "dark_e", "level", "deviation", "untold"),
        "arrays": [_array(array) for array in found.arrays],
        "regions": [_region(report) for report in found.regions],
        "regions_in_all": found.regions_in_all,
        "causes": [asdict(cause) for cause in found.causes],
        "receiver_error": found.error,
        "advice": found.advice,
    })  # fmt: skip


def _array(array: ArrayReport) -> dict[str, Any]:
    packet, tally, noise = array.packet, array.tally, array.noise
    return {
        "id": packet.identity,
        "orientation": str(packet.orientation),
        **_fields(tally, "packets", "first_frame", "last_frame", "first_distance_m", "last_distance_m"),
        **_fields(packet.pose, "x", "y"),
        **_optics(packet.pose, array.contrast),
        "score": array.score,
        "codewords": {name: _fields(layer, "ok", "failed") for name, layer in tally.layers.items()},
        "clock": array.clock and asdict(array.clock),
        "noise": noise and {"lit": None if array.clipped else noise.lit, "dark": noise.dark},
        "exposure_frames": array.exposure,
        "expected_m": array.reach,
    }


def _region(report: RegionReport) -> dict[str, Any]:
    header, array = report.header, report.would_be
    return {
        **_fields(report.region, "x", "y", "width", "height", "contrast", "saturated", "blinks", "at_border"),
        "speed_px": report.region.speed,
        "pattern_part": report.pattern_part,
        "frames_a_pattern": report.rate and report.rate.frames,
        "lamp_frames": report.lamp_frames,
        "header": header and {
            **_fields(header, "score", "size_px", "pairs"),
            "blur_px": header.fit.pose.blur, "period_frames": header.period,
            "may_be": [{"id": number, "orientation": str(seen_as)} for number, seen_as in header.hypotheses],
        },
        "would_be": array and {
            **_optics(array.pose, array.contrast), "phase_patterns": array.clock and array.clock.phase_patterns,
            "expected_m": array.reach,
        },
        "array": report.array and report.array.packet.identity,
        "reads_with": report.remedy and options(report.remedy.changes),
        "causes": [asdict(cause) for cause in report.causes],
    }  # fmt: skip


def _optics(pose: Pose, contrast: float) -> dict[str, float]:
    return {"pitch_px": pose.pitch, "blur_px": pose.blur, "contrast": contrast}


def _fields(value: object, *names: str) -> dict[str, Any]:
    return {name: getattr(value, name) for name in names}


def _plain(value: Any) -> Any:
    """Round numbers to five digits; infinite numbers become None, tuples lists, and keys strings."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.5g}") if isfinite(value) else None
    return value
