"""Diagnosis of a film: one pass over all frames, then a close analysis of the stretch with the most blinking light."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Protocol

import numpy as np

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.link.film import FrameProgress, FrameSource, silent
from heliograph.link.truth import departures
from heliograph.probe.activity import Stretch, Stretches
from heliograph.probe.arrays import ArrayReport, ArrayWatch, Setup, measure_array
from heliograph.probe.causes import (
    SATURATED,
    ArrayLike,
    Cause,
    FilmMeasures,
    RegionReport,
    film_causes,
    other_settings,
    region_causes,
)
from heliograph.probe.frames import FrameTimes, FrameWatch
from heliograph.probe.headers import HeaderMatch, find_header
from heliograph.probe.levels import Levels, LevelWatch
from heliograph.probe.light import LightRate, lamp_period, light_rate, pattern_part
from heliograph.probe.noise import NoiseEstimate, NoiseWatch
from heliograph.probe.reach import reaches
from heliograph.probe.regions import Region, regions_of
from heliograph.probe.screens import area_of, regions_in, screen_cause, screen_causes, screen_film_causes
from heliograph.probe.trials import find_remedy, find_turned_remedy, is_blurred, other_packets
from heliograph.receive import ReceiveSettings
from heliograph.receive.geometry.window import Window
from heliograph.receive.observe.noise import Noise
from heliograph.receive.settings import DetectSettings
from heliograph.receive.sync.frame_clock import STEP_TOLERANCE
from heliograph.signal.settings import SignalSettings


class Film(FrameSource, Protocol):
    """Open film, or frames with the same interface."""

    @property
    def rate_hz(self) -> float:
        """Frames per second by the container."""

    @property
    def frame_count(self) -> int | None:
        """Expected number of frames; None if unknown."""


@dataclass(frozen=True)
class Findings:
    """Diagnosis of a film.

    Attributes
    ----------
    path
        Name of the film for messages.
    width, height, bits
        Columns and rows of the frames, and bits per pixel.
    setup
        Settings for the reception.
    times
        Time stamps of the frames.
    levels
        Gray levels of some frames.
    noise
        Noise and gain by photon transfer.
    arrays
        Arrays decoded with the settings.
    regions
        Blinking regions, the strongest first.
    regions_in_all
        Number of all regions.
    causes
        Causes of the complete film.
    error
        Receiver error; empty for no error.
    broken
        Film error; None for no error.
    stretch
        Frames of the close analysis; None if the film has too few.
    """

    path: str
    width: int
    height: int
    bits: int
    setup: Setup
    times: FrameTimes
    levels: Levels
    noise: NoiseEstimate
    arrays: tuple[ArrayReport, ...]
    regions: tuple[RegionReport, ...]
    regions_in_all: int
    causes: tuple[Cause, ...]
    error: str
    broken: BaseException | None
    stretch: Stretch | None

    @property
    def read(self) -> bool:
        """True if an array was decoded with the settings."""
        return bool(self.arrays)

    @property
    def screen(self) -> Cause | None:
        """Cause "screen" of a film with a screen in place of an array; None for other films."""
        return next((cause for cause in self.causes if cause.kind == "screen"), None)

    @property
    def rate(self) -> LightRate | None:
        """Pattern duration by the clearest region."""
        return _best_rate(self.regions)

    @property
    def advice(self) -> list[str]:
        """Distinct remedies, the most important first."""
        causes = [*(cause for report in self.regions for cause in report.causes), *self.causes]
        # proven remedies first, regions that may be no arrays last
        early, late = ("other settings", "short"), ("lamp", "moves", "no header")
        causes.sort(key=lambda cause: (not cause.proven, cause.kind not in early, cause.kind in late))
        return list(dict.fromkeys(line for cause in causes for line in cause.advice))


def _best_rate(reports: Sequence[RegionReport]) -> LightRate | None:
    return max((report.rate for report in reports if report.rate), key=lambda rate: rate.explained, default=None)


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
    """Diagnose why a film is not decoded, and measure its frames, light and noise.

    Parameters
    ----------
    film
        An open film; only the frames are used.
    signal
        Signal of the light for the receiver.
    settings
        Settings of the receiver.
    progress
        Called with the number of frames so far.
    reading
        True to run the receiver on the film; False if the result is known.
    every
        Analyse only every n-th stretch of a long film.
    most
        Maximum number of frames; None for all.
    trials
        True to try other settings on regions like arrays, which takes up to minutes.

    Returns
    -------
    The diagnosis. If the film ends in an error, or on Ctrl-C, the diagnosis of the frames so far.

    Raises
    ------
    SettingsError
        The receiver does not support the signal.
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
    watch.arrays.finish()
    setup = Setup(signal, settings, watch.frames.times().rate_hz)
    differing = departures(film, signal)
    found = _diagnose(watch, watch.last, str(film.path), setup, broken, trials and not differing)
    if not differing or found.read:
        return found
    # other causes follow from the wrong settings
    regions = tuple(replace(report, causes=(), would_be=None) for report in found.regions)
    return replace(found, regions=regions, causes=other_settings(differing, found.causes))


class _Watch:
    """Statistics of a film in bounded memory."""

    def __init__(self, film: Film, signal: SignalSettings, settings: ReceiveSettings | None, every: int):
        self.frames, self.stretches = FrameWatch(film.rate_hz), Stretches(every)
        self.levels, self.noise = LevelWatch(film.frame_count), NoiseWatch(film.frame_count)
        self.arrays = ArrayWatch(signal, settings)
        self.last: Frame | None = None

    def add(self, frame: Frame) -> None:
        """Add the next frame."""
        self.last, repeated = frame, self.frames.add(frame)
        self.levels.add(frame)
        self.noise.add(frame, repeated)
        if not repeated:
            self.stretches.add(frame)
        self.arrays.push(frame)


def _diagnose(
    watch: _Watch, last: Frame, path: str, setup: Setup, broken: BaseException | None, trials: bool
) -> Findings:
    times, levels, error = watch.frames.times(), watch.levels.levels(), watch.arrays.error
    noise, arrays = watch.noise.noise(levels.ceiling), watch.arrays.reports(last.full_scale)
    stretch, is_screen = watch.stretches.best(), setup.settings.receiver == "screen"
    regions, reports, count = list[Region](), list[RegionReport](), 0
    area, unexpected = None, None
    if stretch is not None and not arrays:
        area = area_of(stretch.frames) if is_screen else None
        unexpected = None if is_screen else screen_cause(stretch.frames, times.rate_hz)
    if stretch is not None and unexpected is None and not (is_screen and area is None):
        regions, count = regions_of(stretch, levels.ceiling)
        if area is not None:  # all other changes belong to the same screen
            regions = regions_in(area, regions)
            count = len(regions)
    for region in regions:
        assert stretch is not None
        analysis = _Analysis(stretch, setup, noise, levels, trials and not is_screen)
        identity = watch.arrays.identity_at(region, stretch.frames)
        try:
            report = analysis.report(region, None if identity is None else arrays[identity])
            report = replace(report, would_be=analysis.describe_array(report) if area is None else None)
        except (MemoryError, KeyboardInterrupt) as interruption:
            broken = interruption
            break
        if identity is not None and report.array is not None:
            arrays[identity] = report.array
        if area is None:
            report = replace(report, causes=region_causes(report, setup, last.full_scale))
        else:
            report = replace(report, causes=screen_causes(report, area, stretch.frames, setup))
        reports.append(report)
    is_blank = stretch is not None and not reports and not arrays
    causes = film_causes(FilmMeasures(times, levels, setup, error, _best_rate(reports)), is_blank and not is_screen)
    if is_screen:
        causes = screen_film_causes(causes, levels, is_blank)
    if unexpected is not None:
        causes = (unexpected,)
    return Findings(
        path, last.pixels.shape[1], last.pixels.shape[0], last.bits, setup, times, levels, noise,
        tuple(arrays.values()), tuple(reports), count, causes, error, broken, stretch,
    )  # fmt: skip


@dataclass(frozen=True)
class _Analysis:
    """Close analysis of the regions of a stretch."""

    stretch: Stretch
    setup: Setup
    noise: NoiseEstimate
    levels: Levels
    trials: bool

    def report(self, region: Region, array: ArrayReport | None) -> RegionReport:
        """Measure a region, and try other settings."""
        setup, all_frames = self.setup, self.stretch.frames
        quiet = float(np.median(self.stretch.noise))
        frames = [_crop(frame, region.window) for frame in all_frames]
        rate = light_rate(all_frames, region, quiet, self.levels.ceiling, setup.signal.slot_order)
        if array is not None:
            return RegionReport(region, rate, array=measure_array(array, frames, setup))
        part, lamp_frames = pattern_part(all_frames, region, quiet), lamp_period(region.brightness)
        report = RegionReport(region, rate, lamp_frames, part, self._header(region, frames, rate))
        header, is_complete = report.header, not region.at_border and region.speed_px < 1
        if header is not None and self.trials:
            noise = self._difference_noise(region, header.fit.gain)
            is_square = is_complete and region.saturated < 0.5 and not region.is_oblong
            remedy = find_remedy(frames, setup, rate, header, noise, is_square)
            report = replace(report, remedy=remedy)
        # the outline of a defocused array is round and shows no turn
        is_round = header is not None and report.has_header and is_blurred(header.fit.pose)
        if report.remedy is None and self.trials and rate is not None and is_complete and not is_round:
            form = other_packets(header, setup.signal, rate.frames) if header is not None else {}
            report = replace(report, remedy=find_turned_remedy(frames, setup, rate, (region.x, region.y), form))
        return report

    def _header(self, region: Region, frames: Sequence[Frame], rate: LightRate | None) -> HeaderMatch | None:
        """Search a header in a frame of each pattern; larger regions are changes of the scene."""
        step, detect = rate.frames if rate is not None else self.setup.frames_a_pattern, self.setup.settings.detect
        if step >= 1 + STEP_TOLERANCE:
            frames = [frames[k] for k in np.arange(0, len(frames) - 0.5, step).round().astype(int) if k < len(frames)]
        limit_px = 1.5 * max(detect.max_side_px, DetectSettings().max_side_px)
        if region.side >= limit_px or len(frames) < 4:
            return None
        speed = max(step, 1.0) * region.speed[0], max(step, 1.0) * region.speed[1]
        return find_header(frames, (region.x, region.y), region.side, self.setup.signal.side, speed)

    def describe_array(self, report: RegionReport) -> ArrayLike | None:
        """Describe an undecoded region as an array, by the packet of a trial or by the header."""
        signal, remedy, header = self.setup.signal, report.remedy, report.clear_header
        if remedy is not None and remedy.trial.detections:
            fit, signal = remedy.trial.detections[0].fit, remedy.trial.signal
        elif header is not None:
            fit = header.fit
        else:
            return None
        settings, clock = self.setup.settings, remedy.clock if remedy is not None else None
        array = ArrayLike(fit.pose, fit.gain / self.stretch.frames[0].full_scale, clock)
        if report.region.saturated > SATURATED:
            return array
        noise, distance_m = self._difference_noise(report.region, fit.gain), settings.calibration.distance_m(fit.pose)
        reach = reaches(fit.pose, fit.gain, noise, distance_m, signal, settings.detect.min_side_px)
        return replace(array, reach=reach)

    def _difference_noise(self, region: Region, gain: float) -> Noise:
        """Return the noise of the difference of two frames by photon transfer, or by the quiet blocks."""
        level, quiet = float(np.median(region.brightness)), float(np.median(self.stretch.noise)) ** 2
        lit, dark = self.noise.variance_at(level), self.noise.variance_at(max(level - 0.5 * gain, 0.0))
        return Noise(2 * (lit or quiet), 2 * (dark or quiet))


def _crop(frame: Frame, window: Window) -> Frame:
    x, y, width, height = window
    left, top = x - frame.origin[0], y - frame.origin[1]
    return replace(frame, pixels=frame.pixels[top : top + height, left : left + width], origin=(x, y))
