"""Plan of a data set: split, settings, seed and scene of each film."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from heliograph import __version__
from heliograph.base.errors import SettingsError, shown
from heliograph.channel.motion import nearest_m
from heliograph.link.film import frames_of
from heliograph.link.settings import LinkSettings
from heliograph.measure.bench import block_settings
from heliograph.sweeps.plan import plan
from heliograph.sweeps.points import Point, Recorded

SPLITS = ("train", "validation", "test")  # names of the splits and folders

SEEDS = 1_000_000
"""Number of seeds per data set, the maximum number of films; data sets of different seeds are disjoint."""

CUTOUT_SIDES = 1.5  # side of a cut-out relative to the largest image of an array in the film


@dataclass(frozen=True)
class PlannedFilm:
    """Film of a data set."""

    # Number in the data set, from 0
    number: int
    split: str
    # Settings, varied values and recordings
    point: Point
    # Seed of messages, road, scene, noise and position
    seed: int
    # Link settings with the film length
    settings: LinkSettings
    # Number of frames, dropped frames included
    frames: int
    # Side of the cut-outs in px, at most the larger side of the frame
    cutout_px: int

    @property
    def name(self) -> str:
        """Path within the data set."""
        return f"{self.split}/{self.number:06}.h5"

    @property
    def bytes(self) -> int:
        """Size of frames and cut-outs in bytes."""
        channel = self.settings.channel
        pixels = channel.camera.width * channel.camera.height + len(channel.arrays) * self.cutout_px**2
        return self.frames * pixels * (1 if channel.sensor.bits == 8 else 2)


@dataclass(frozen=True)
class DatasetPlan:
    """Plan of a data set.

    Attributes
    ----------
    films
        Films in the order of numbers.
    points
        Combinations of varied values.
    about
        Inputs of the films as plain values; equal plans give equal films.
    """

    films: Sequence[PlannedFilm]
    points: Sequence[Point]
    about: Mapping[str, Any]

    @property
    def bytes(self) -> int:
        """Size of all films in bytes."""
        return sum(film.bytes for film in self.films)

    @property
    def frames(self) -> int:
        """Number of frames of all films."""
        return sum(film.frames for film in self.films)


def planned(
    vary: Mapping[str, Iterable[Any]],
    preset: str,
    over: Mapping[str, Any],
    films: int,
    splits: Sequence[int],
    packets: int | None,
    seed: int,
    backgrounds: Sequence[Path] = (),
    imu: Path | None = None,
) -> DatasetPlan:
    """Plan a data set; see `write_dataset`."""
    _check_whole("seed", seed, 0, (1 << 40) - 1)  # SEEDS times the seed has 64 bits
    _check_whole("number of films", films, 1, SEEDS)
    if packets is not None:
        _check_whole("number of packets", packets, 1, 10_000)
    counts = _counts(films, splits)
    points = plan(vary, preset, over, 0, backgrounds[0] if backgrounds else None, imu)
    if len(points) * films > SEEDS:
        raise SettingsError(f"a data set has at most {SEEDS} films, not {len(points) * films}: write several data sets")
    clips = _clips([Recorded.of(path) for path in backgrounds], [name for name in SPLITS if counts[name]])
    out = list[PlannedFilm]()
    for point in points:
        settings = block_settings(point.settings, packets)
        if not settings.channel.arrays:
            raise SettingsError("a data set needs arrays: channel.arrays is empty")
        frames, cutout_px = frames_of(settings), _cutout_px(settings)
        if not frames:
            raise SettingsError(f"a film of {point.text} has no frames: raise channel.duration_s")
        for split, k in ((name, k) for name in SPLITS for k in range(counts[name])):
            number, source = len(out), point
            if clips:
                recordings = {**point.recordings, "footage": clips[split][k % len(clips[split])]}
                source = replace(point, recordings=recordings)
            out.append(PlannedFilm(number, split, source, SEEDS * int(seed) + number, settings, frames, cutout_px))
    about = {
        "version": __version__,
        "seed": int(seed),
        "films_a_point": int(films),
        "splits": counts,
        "points": [{"choice": dict(point.choice), "settings": asdict(point.settings)} for point in points],
        "packets": packets,
        "recordings": {name: [clip.digest for clip in part] for name, part in clips.items()},
        "imu": points[0].recordings["imu"].digest if imu else None,
    }
    return DatasetPlan(out, points, about)


def _cutout_px(settings: LinkSettings) -> int:
    """Return the side of the cut-outs for the nearest array."""
    channel, signal = settings.channel, settings.signal
    closest_m = max(nearest_m(channel) + min(array.z_offset_m for array in channel.arrays), 0.1)
    side = signal.side * channel.emitter.pitch_m * channel.camera.focal_px / closest_m
    size = math.ceil(min(CUTOUT_SIDES * side, 1e6)) + 8  # 8 px for blur
    return min(size, max(channel.camera.width, channel.camera.height))


def _counts(films: int, splits: Any) -> dict[str, int]:
    """Return the number of films by split, as close as possible to the shares, at least one for a positive share."""
    shares = list(splits) if isinstance(splits, (list, tuple)) else []
    valid = all(type(share) is int and 0 <= share <= SEEDS for share in shares)
    if len(shares) != len(SPLITS) or not valid or not sum(shares):
        given = ",".join(map(str, splits)) if isinstance(splits, (list, tuple)) else shown(splits)
        raise SettingsError(f"splits are the shares of train, validation and test, such as 80,10,10, not {given}")
    wanted = [share for share in shares if share]
    if films < len(wanted):
        raise SettingsError(f"{films} films of each kind cannot be split in {len(wanted)}: ask for more films")
    counts = [max(films * share // sum(shares), 1) if share else 0 for share in shares]
    for _ in range(abs(films - sum(counts))):
        # adjust the split with the largest deviation
        deficit = [films * share / sum(shares) - count for share, count in zip(shares, counts, strict=True)]
        if sum(counts) < films:
            counts[max(range(3), key=lambda k: deficit[k] if shares[k] else -math.inf)] += 1
        else:
            counts[min(range(3), key=lambda k: deficit[k] if counts[k] > 1 else math.inf)] -= 1
    return dict(zip(SPLITS, counts, strict=True))


def _clips(clips: Sequence[Recorded], splits: Sequence[str]) -> dict[str, list[Recorded]]:
    """Assign footage to splits: a clip to each later split, the others to the first."""
    if not clips:
        return {}
    if len({clip.digest for clip in clips}) < len(clips):
        raise SettingsError("--background names the same footage twice: no scene may be in two splits")
    if len(clips) < len(splits):
        raise SettingsError(
            f"{len(splits)} splits need a footage each, not {len(clips)}: repeat --background, or write --splits 1,0,0"
        )
    first = len(clips) - len(splits) + 1
    return {splits[0]: list(clips[:first]), **{name: [clips[first + k]] for k, name in enumerate(splits[1:])}}


def _check_whole(name: str, value: Any, low: int, high: int) -> None:
    if not isinstance(value, (int, np.integer)) or isinstance(value, bool) or not low <= value <= high:
        raise SettingsError(f"the {name} is a whole number from {low} to {high}, not {shown(value)}")
