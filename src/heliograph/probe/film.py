"""Diagnosis of a film: one pass over all frames, then a close analysis of the stretch with the most blinking light."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Protocol

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.link.budget import reaches
from heliograph.link.film import FrameProgress, FrameSource, silent
from heliograph.link.truth import departures
from heliograph.probe.activity import Stretch, Stretches
from heliograph.probe.arrays import ArrayReport, ArrayWatch, Setup, measure_array
from heliograph.probe.causes import (
    FILM,
    SATURATED,
    ArrayLike,
    Cause,
    FilmMeasures,
    RegionReport,
    diagnose,
    other_settings,
    region_causes,
)
from heliograph.probe.frames import FrameTimes, FrameWatch
from heliograph.probe.headers import HeaderMatch, find_header
from heliograph.probe.levels import Levels, LevelWatch
from heliograph.probe.light import LightRate, lamp_period, light_rate, pattern_part
from heliograph.probe.noise import NoiseEstimate, NoiseWatch
from heliograph.probe.regions import Region, regions_of
from heliograph.probe.screens import area_of, regions_in, screen_cause, screen_causes, screen_film_causes
from heliograph.probe.trials import Remedy, find_remedy, find_turned_remedy, is_blurred, other_packets
from heliograph.receive.geometry.window import Window
from heliograph.receive.observe.cutout import Noise
from heliograph.receive.settings import DetectSettings, ReceiveSettings
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
        Film error, or "interrupted" after Ctrl-C; empty for no error.
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
    broken: str
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


def _ending(error: BaseException) -> str:
    reason = str(error) or "not enough memory: probe fewer or smaller frames"
    return "interrupted" if isinstance(error, KeyboardInterrupt) else reason


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
    frame_watch, stretches = FrameWatch(film.rate_hz), Stretches(every)
    level_watch, noise_watch = LevelWatch(film.frame_count), NoiseWatch(film.frame_count)
    array_watch = ArrayWatch(signal, settings if reading else None)
    last: Frame | None = None
    broken = ""
    try:
        for count, frame in enumerate(islice(film, most), 1):
            last, repeated = frame, frame_watch.add(frame)
            level_watch.add(frame)
            noise_watch.add(frame, repeated)
            if not repeated:
                stretches.add(frame)
            array_watch.push(frame)
            progress(count)
    except (MediaError, MemoryError, KeyboardInterrupt) as error:
        if last is None:
            raise
        broken = _ending(error)
    if last is None:
        raise MediaError(f"{film.path} holds no frames: record it again")
    array_watch.finish()
    times, levels, stretch = frame_watch.times(), level_watch.levels(), stretches.best()
    noise, arrays = noise_watch.noise(levels.ceiling), array_watch.reports(last.full_scale)
    setup, differing = Setup(signal, settings, times.rate_hz), departures(film, signal)
    is_screen, reports, count = settings.receiver == "screen", list[RegionReport](), 0
    screen: Cause | None = None
    if stretch is not None:
        analysis = _Analysis(stretch, setup, noise, levels, trials and not differing and not is_screen)
        area = area_of(stretch.frames) if is_screen and not arrays else None
        screen = screen_cause(stretch.frames, times.rate_hz) if not is_screen and not arrays else None
        regions = list[Region]()
        if area is not None:  # all changes outside belong to the same screen
            regions = regions_in(area, regions_of(stretch, levels.ceiling)[0])
            count = len(regions)
        elif not is_screen and screen is None:
            regions, count = regions_of(stretch, levels.ceiling)
        try:
            for region in regions:
                identity = array_watch.identity_at(region, stretch.frames)
                report = analysis.report(region, area, None if identity is None else arrays[identity])
                if identity is not None and report.array is not None:
                    arrays[identity] = report.array
                reports.append(report)
        except (MemoryError, KeyboardInterrupt) as error:
            broken = _ending(error)
    is_blank = stretch is not None and not reports and not arrays
    is_still = is_blank and not is_screen
    causes = diagnose(FILM, FilmMeasures(times, levels, setup, array_watch.error, _best_rate(reports), is_still))
    if is_screen:
        causes = screen_film_causes(causes, levels, is_blank)
    if screen is not None:
        causes = (screen,)
    if differing and not arrays:  # other causes follow from the wrong settings
        reports = [replace(report, causes=(), would_be=None) for report in reports]
        causes = other_settings(differing, causes)
    return Findings(
        str(film.path), last.pixels.shape[1], last.pixels.shape[0], last.bits, setup, times, levels, noise,
        tuple(arrays.values()), tuple(reports), count, causes, array_watch.error, broken, stretch,
    )  # fmt: skip


@dataclass(frozen=True)
class _Analysis:
    """Close analysis of the regions of a stretch."""

    stretch: Stretch
    setup: Setup
    noise: NoiseEstimate
    levels: Levels
    trials: bool

    def report(self, region: Region, area: Floats | None, array: ArrayReport | None) -> RegionReport:
        """Measure a region, try other settings, and name the causes."""
        setup, frames, full_scale = self.setup, self.stretch.frames, self.stretch.frames[0].full_scale
        quiet, parts = float(np.median(self.stretch.noise)), [_crop(frame, region.window) for frame in frames]
        rate = light_rate(frames, region, quiet, self.levels.ceiling, setup.signal.slot_order)
        if array is not None:
            report = RegionReport(region, rate, array=measure_array(array, parts, setup))
            return replace(report, causes=region_causes(report, setup, full_scale))
        part, lamp_frames = pattern_part(frames, region, quiet), lamp_period(region.brightness)
        report = RegionReport(region, rate, lamp_frames, part, self._header(region, parts, rate))
        if area is not None:
            return replace(report, causes=screen_causes(report, area, frames, setup))
        report = replace(report, remedy=self._remedy(report, parts) if self.trials else None)
        report = replace(report, would_be=self._describe(report))
        return replace(report, causes=region_causes(report, setup, full_scale))

    def _remedy(self, report: RegionReport, frames: Sequence[Frame]) -> Remedy | None:
        """Try other settings, and the corners of the outline."""
        region, rate, header, remedy = report.region, report.rate, report.header, None
        is_complete = not region.at_border and region.speed_px < 1
        if header is not None:
            noise = self._difference_noise(region, header.fit.gain)
            is_square = is_complete and region.saturated < 0.5 and not region.is_oblong
            remedy = find_remedy(frames, self.setup, rate, header, noise, is_square)
        # the outline of a defocused array is round and shows no turn
        is_round = header is not None and report.has_header and is_blurred(header.fit.pose)
        if remedy is None and rate is not None and is_complete and not is_round:
            form = other_packets(header, self.setup.signal, rate.frames) if header is not None else {}
            remedy = find_turned_remedy(frames, self.setup, rate, (region.x, region.y), form)
        return remedy

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

    def _describe(self, report: RegionReport) -> ArrayLike | None:
        """Describe an undecoded region as an array, by the packet of a trial or by the header."""
        signal, settings, remedy, header = self.setup.signal, self.setup.settings, report.remedy, report.clear_header
        if remedy is not None and remedy.trial.detections:
            fit, signal = remedy.trial.detections[0].fit, remedy.trial.signal
        elif header is not None:
            fit = header.fit
        else:
            return None
        clock = remedy.clock if remedy is not None else None
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
