"""A film probed: gone through once, frame by frame, and then its liveliest stretch looked into."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from heliograph.base.errors import HeliographError, MediaError
from heliograph.base.frames import Frame
from heliograph.link.film import FrameProgress, silent
from heliograph.link.truth import departures
from heliograph.probe.activity import Stretch, Stretches
from heliograph.probe.arrays import ArraySeen, ArrayWatch, Asked, looked_into
from heliograph.probe.causes import (
    SATURATED,
    WHATEVER_SENT,
    ArrayLike,
    Cause,
    RegionSeen,
    film_causes,
    other_settings,
    region_causes,
    still,
)
from heliograph.probe.frames import FrameTimes, FrameWatch
from heliograph.probe.headers import header_seen
from heliograph.probe.levels import Levels, LevelWatch
from heliograph.probe.light import LightRate, lamp_period, light_rate, pattern_part
from heliograph.probe.noise import NoiseFound, NoiseWatch
from heliograph.probe.reach import Reach, reaches
from heliograph.probe.regions import Region, regions_of
from heliograph.probe.screens import ScreenLook, films_causes, screen_cause
from heliograph.probe.trials import SURE_HEADER, is_blurred, other_packets, what_reads, what_reads_turned
from heliograph.receive import Packet, ReceiveSettings, make_receiver
from heliograph.receive.events import DetectEvent
from heliograph.receive.geometry.window import Window
from heliograph.receive.observe.noise import Noise
from heliograph.receive.settings import DetectSettings
from heliograph.receive.sync.frame_clock import STEP_TOLERANCE
from heliograph.signal.settings import SignalSettings


class Film(Protocol):
    """An open film, or frames in its place."""

    @property
    def path(self) -> Path | str:
        """Names the film."""

    @property
    def rate_hz(self) -> float:
        """Frames per second as it says."""

    @property
    def frame_count(self) -> int | None:
        """Frames to expect, None where unknown."""

    def __iter__(self) -> Iterator[Frame]: ...


@dataclass(frozen=True)
class Findings:
    """All that a film tells.

    Attributes
    ----------
    path
        Names the film in messages.
    width, height, bits
        Columns and rows of its frames, and bits of a gray level.
    asked
        What it was to be read with.
    times
        How its frames are stamped.
    levels
        Gray levels of some of its frames.
    noise
        Noise and gain by photon transfer.
    arrays
        Arrays that were read with what was asked for.
    regions
        Regions in which something blinks, the strongest first.
    regions_in_all
        How many there are.
    causes
        What is the matter with the film as a whole.
    error
        Why the receiver ended early; empty where it did not.
    broken
        Why the film itself did; None where it did not.
    stretch
        The frames that were looked into; None where there were too few.
    """

    path: str
    width: int
    height: int
    bits: int
    asked: Asked
    times: FrameTimes
    levels: Levels
    noise: NoiseFound
    arrays: tuple[ArraySeen, ...]
    regions: tuple[RegionSeen, ...]
    regions_in_all: int
    causes: tuple[Cause, ...]
    error: str
    broken: BaseException | None
    stretch: Stretch | None

    @property
    def read(self) -> bool:
        """Whether an array was read with what was asked for."""
        return bool(self.arrays)

    @property
    def screen(self) -> Cause | None:
        """That the film shows a screen, but was to be read by a receiver for arrays; None if not."""
        return next((one for one in self.causes if one.kind == "screen"), None)

    @property
    def rate(self) -> LightRate | None:
        """Frames that a pattern lasts, by the region that shows it best."""
        known = [one.rate for one in self.regions if one.rate is not None]
        return max(known, key=lambda one: one.explained) if known else None

    @property
    def advice(self) -> list[str]:
        """What to change, the gravest first, each line once."""
        causes = [*(cause for one in self.regions for cause in one.causes), *self.causes]
        # what reads a region goes before what would only help, and what may be no array comes last
        # kinds of causes of what need not be an array
        causes.sort(
            key=lambda cause: (
                not cause.proven,
                cause.kind not in ("other settings", "short"),
                cause.kind in ("lamp", "moves", "no header"),
            )
        )
        return list(dict.fromkeys(line for cause in causes for line in cause.advice))


def probe_film(
    film: Film,
    signal: SignalSettings,
    settings: ReceiveSettings,
    progress: FrameProgress = silent,
    *,
    reading: bool = True,
    every: int = 1,
    most: int | None = None,
    trials: bool = True,
) -> Findings:
    """Tell what a film shows, and why it is not read where it is not.

    Parameters
    ----------
    film
        An open film; its frames alone are looked at.
    signal
        The light's signal, as the receiver is to take it.
    settings
        The receiver that is to read it.
    progress
        Called with the number of frames gone through.
    reading
        Whether the receiver reads the film too; False where it is known to read nothing.
    every
        Every so many stretches of a long film one is looked at.
    most
        Most frames that are looked at; None for all.
    trials
        Whether other settings are tried on what is like an array; that takes up to minutes.

    Returns
    -------
    What was found. Where the film breaks off, or on Ctrl-C, it is that of the frames before.

    Raises
    ------
    SettingsError
        The receiver cannot read such a signal.
    MediaError
        The film has no frames.
    """
    watch = _Watch(film, signal, settings if reading else None, every)
    broken: BaseException | None = None
    try:
        for count, frame in enumerate(islice(film, most), 1):
            watch.add(frame)
            progress(count)
    except (MediaError, MemoryError, KeyboardInterrupt) as error:
        broken = error
    if watch.last is None:
        raise broken or MediaError(f"{film.path} holds no frames: record it again")
    asked = Asked(signal, settings, watch.frames.times().rate_hz)
    differing = departures(film, signal)
    found = _findings(watch, film, asked, broken, trials and not differing)
    return _by_note(found, differing) if differing and not found.read else found


def _by_note(found: Findings, differing: Sequence[tuple[str, Any, Any]]) -> Findings:
    """Name the settings that differ from the film's note in place of what follows from them."""
    causes = [cause for cause in found.causes if cause.kind in WHATEVER_SENT]
    regions = tuple(replace(seen, causes=(), would_be=None) for seen in found.regions)
    return replace(found, regions=regions, causes=(other_settings(differing), *causes))


class _Watch:
    """All that is kept of a film while it is gone through: as much of a long one as of a short one."""

    def __init__(self, film: Film, signal: SignalSettings, settings: ReceiveSettings | None, every: int):
        self.frames, self.stretches = FrameWatch(film.rate_hz), Stretches(every)
        self.levels, self.noise = LevelWatch(film.frame_count), NoiseWatch(film.frame_count)
        self.arrays, self.error = ArrayWatch(), ""
        self._receiver = make_receiver(signal, settings, self._note) if settings is not None else None
        self.last: Frame | None = None

    def add(self, frame: Frame) -> None:
        """Take a frame."""
        copied = self.frames.add(frame)
        self.levels.add(frame)
        self.noise.add(frame, copied)
        if not copied:
            self.stretches.add(frame)
        self.last = frame
        if self._receiver is not None:
            self._read(self._receiver.push(frame))

    def finish(self) -> None:
        """Take what the receiver still has."""
        if self._receiver is not None:
            self._read(self._receiver.finish())

    def _read(self, packets: Iterator[Packet]) -> None:
        try:
            for packet in packets:
                self.arrays.add(packet)
        except HeliographError as error:
            self._receiver, self.error = None, str(error)

    def _note(self, event: Any) -> None:
        if isinstance(event, DetectEvent):
            self.arrays.found(event.detection)


def _findings(watch: _Watch, film: Film, asked: Asked, broken: BaseException | None, trials: bool) -> Findings:
    """What was found, once all frames were gone through."""
    watch.finish()
    last = watch.last
    assert last is not None
    times, levels = watch.frames.times(), watch.levels.levels()
    noise = watch.noise.noise(levels.ceiling)
    arrays = {one.identity: one for one in watch.arrays.arrays(last.full_scale)}
    stretch = watch.stretches.best()
    screen = ScreenLook.of(stretch, asked, levels) if asked.settings.receiver == "screen" else None
    other = None if screen is not None or arrays or stretch is None else screen_cause(stretch.frames, times.rate_hz)
    regions, count = regions_of(stretch, levels.ceiling) if stretch and other is None else ([], 0)
    if screen is not None:  # all that changes about it is the same screen
        regions, count = ([], 0) if arrays else screen.regions(regions)
    seen = list[RegionSeen]()
    for region in regions:
        assert stretch is not None
        identity = watch.arrays.at(region, stretch.frames)
        array = None if identity is None else arrays[identity]
        try:
            one = _looked_into(region, stretch, array, asked, noise, levels, trials and screen is None)
        except (MemoryError, KeyboardInterrupt) as error:
            broken = error
            break
        if one.array is not None:
            arrays[one.array.identity] = one.array
        told = region_causes(one, asked, last.full_scale) if screen is None else screen.causes(one)
        seen.append(replace(one, causes=told, would_be=one.would_be if screen is None else None))
    rates = [one.rate for one in seen if one.rate is not None]
    rate = max(rates, key=lambda one: one.explained) if rates else None
    causes = film_causes(times, levels, asked, watch.error, rate)
    if screen is not None:
        causes = films_causes(causes)
    if other is not None:
        causes = (other,)
    elif not seen and not arrays and stretch is not None:
        causes = (*(screen.nothing_seen() if screen is not None else (still(asked),)), *causes)
    return Findings(
        path=str(film.path), width=last.pixels.shape[1], height=last.pixels.shape[0], bits=last.bits, asked=asked,
        times=times, levels=levels, noise=noise, arrays=tuple(arrays.values()), regions=tuple(seen),
        regions_in_all=count, causes=causes, error=watch.error, broken=broken, stretch=stretch,
    )  # fmt: skip


def _looked_into(
    region: Region, stretch: Stretch, array: ArraySeen | None, asked: Asked, noise: NoiseFound, levels: Levels,
    trials: bool,
) -> RegionSeen:  # fmt: skip
    """All that can be told of a region, and of the array that it is."""
    quiet = float(np.median(stretch.noise))
    frames = [_part(frame, region.window) for frame in stretch.frames]
    rate = light_rate(stretch.frames, region, quiet, levels.ceiling, asked.signal.slot_order)
    if array is not None:
        return RegionSeen(region, rate, None, 1.0, None, None, looked_into(array, frames, asked))
    part = pattern_part(stretch.frames, region, quiet)
    patterns, step = _a_pattern_each(frames, rate.frames if rate is not None else asked.frames_a_pattern)
    speed = step * region.speed[0], step * region.speed[1]
    # side of a region over that of the largest array that receivers look for from which on no header is looked for: the
    # scene itself moves
    largest = 1.5 * max(asked.settings.detect.max_side_px, DetectSettings().max_side_px)
    header = None
    if region.side < largest and len(patterns) >= 4:
        header = header_seen(patterns, (region.x, region.y), region.side, asked.signal.side, speed)
    found = None
    if header is not None and trials:
        whole = not region.at_border and region.saturated < 0.5 and region.speed_px < 1
        found = what_reads(frames, asked, rate, header, _noise_of(region, noise, quiet, header.fit.gain), whole)
    # what a lens out of focus leaves of an outline is round: it shows no turn
    round_one = header is not None and header.score >= SURE_HEADER and is_blurred(header.fit.pose)
    turnable = rate is not None and not region.at_border and region.speed_px < 1 and not round_one
    if found is None and trials and rate is not None and turnable:
        form = other_packets(header, asked.signal, rate.frames) if header is not None else {}
        found = what_reads_turned(frames, asked, rate, (region.x, region.y), form)
    lamp = lamp_period(region.brightness)
    seen = RegionSeen(region, rate, lamp, part, header, found, None)
    return replace(seen, would_be=_would_be(seen, asked, noise, quiet, frames[0].full_scale))


def _would_be(
    seen: RegionSeen, asked: Asked, noise: NoiseFound, quiet: float, full_scale: int
) -> ArrayLike | None:  # fmt: skip
    """A region as the array that it would be, by the packet read of it once settings are changed, or by its header."""
    signal, known, found = asked.signal, asked.settings.calibration, seen.found
    if found is not None and found.reading.detections:
        fit, signal = found.reading.detections[0].fit, found.reading.signal
    elif seen.header_like is not None:
        fit = seen.header_like.fit
    else:
        return None
    pose, clock = fit.pose, found.clock if found is not None else None
    reach: tuple[Reach, ...] = ()
    if seen.region.saturated <= SATURATED and signal.header == "m_sequence":
        distance_m = known.distance_m(pose)
        light = _noise_of(seen.region, noise, quiet, fit.gain)
        reach = reaches(pose, fit.gain, light, distance_m, signal, asked.settings.detect.min_side_px)
    return ArrayLike(pose.pitch, pose.blur, fit.gain / full_scale, clock, reach)


def _part(frame: Frame, window: Window) -> Frame:
    """A window of a frame."""
    x, y, width, height = window
    left, top = x - frame.origin[0], y - frame.origin[1]
    return replace(frame, pixels=frame.pixels[top : top + height, left : left + width], origin=(x, y))


def _a_pattern_each(frames: Sequence[Frame], step: float) -> tuple[list[Frame], float]:
    """One frame of each pattern, and how many frames one is apart from the next."""
    if step < 1 + STEP_TOLERANCE:
        return list(frames), 1.0
    numbers = np.arange(0, len(frames) - 0.5, step).round().astype(int)
    return [frames[k] for k in numbers if k < len(frames)], step


def _noise_of(region: Region, noise: NoiseFound, quiet: float, gain: float) -> Noise:
    """Noise of a difference of two frames, as far as it is known where an array is not read."""
    level = float(np.median(region.brightness))
    lit, dark = noise.variance_at(level), noise.variance_at(max(level - 0.5 * gain, 0.0))
    return Noise(2 * (lit or quiet**2), 2 * (dark or quiet**2))
