"""What a data set consists of: each film with its split, settings, seed and scene, known beforehand."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from heliograph import __version__
from heliograph.base.config import to_mapping
from heliograph.base.errors import SettingsError, shown
from heliograph.link.film import frames_of
from heliograph.link.settings import LinkSettings
from heliograph.measure.bench import block_settings
from heliograph.sweeps.plan import plan
from heliograph.sweeps.points import Point, Recorded

SPLITS = ("train", "validation", "test")
"""Names of the splits, which are folders."""

SEEDS = 1_000_000
"""Seeds of a data set, and the most films it has: those of two data sets of different seeds are apart."""

CUTOUT_SIDES = 1.5
"""Side of a cut-out in sides of the largest image of an array in its film."""


@dataclass(frozen=True)
class PlannedFilm:
    """A film of a data set."""

    # Its number in the data set, from 0
    number: int
    # Name of its split
    split: str
    # What it is a film of: settings, what varies, and recordings
    point: Point
    # Of messages, road, scene, noise and place
    seed: int
    # The link, with the film's length
    settings: LinkSettings
    # Frames that it has; dropped ones count
    frames: int
    # Rows and columns of its cut-outs in px: those of the frame's larger side at most
    cutout_px: int

    @property
    def name(self) -> str:
        """Its file within the data set."""
        return f"{self.split}/{self.number:06}.h5"

    @property
    def bytes(self) -> int:
        """Bytes of its frames and cut-outs, which are nearly all of the file."""
        channel = self.settings.channel
        pixels = channel.camera.width * channel.camera.height + len(channel.arrays) * self.cutout_px**2
        return self.frames * pixels * (1 if channel.sensor.bits == 8 else 2)


@dataclass(frozen=True)
class DatasetPlan:
    """All films of a data set.

    Attributes
    ----------
    films
        In the order of their numbers.
    points
        What they are films of.
    about
        All that they follow from, as plain values: the same plan makes the same films.
    """

    films: Sequence[PlannedFilm]
    points: Sequence[Point]
    about: Mapping[str, Any]

    @property
    def bytes(self) -> int:
        """Bytes of all films."""
        return sum(film.bytes for film in self.films)

    @property
    def frames(self) -> int:
        """Frames of all films."""
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
    # above the largest seed: times `SEEDS` it is held by 64 bits
    _check_whole("seed", seed, 0, (1 << 40) - 1)
    _check_whole("number of films", films, 1, SEEDS)
    if packets is not None:
        _check_whole("number of packets", packets, 1, 10_000)
    counts = _counts(films, splits)
    points = plan(vary, preset, over, 0, backgrounds[0] if backgrounds else None, imu)
    if len(points) * films > SEEDS:
        raise SettingsError(f"a data set has at most {SEEDS} films, not {len(points) * films}: make several of them")
    clips = _clips([Recorded.of(path) for path in backgrounds], [name for name in SPLITS if counts[name]])
    out = list[PlannedFilm]()
    for point in points:
        settings = block_settings(point.settings, packets)
        if not settings.channel.arrays:
            raise SettingsError("a data set is of arrays: channel.arrays has none")
        frames, cutout_px = frames_of(settings), _cutout_px(settings)
        if not frames:
            raise SettingsError(f"a film of {point.text} has no frames: raise channel.duration_s")
        for split, place in _places(counts):
            number = len(out)
            footage = {"footage": clips[split][place % len(clips[split])]} if clips else {}
            here = Point(point.choice, point.settings, 0, {**point.recordings, **footage}) if footage else point
            out.append(PlannedFilm(number, split, here, SEEDS * int(seed) + number, settings, frames, cutout_px))
    about = {
        "version": __version__,
        "seed": int(seed),
        "films_a_point": int(films),
        "splits": counts,
        "points": [{"choice": dict(one.choice), "settings": to_mapping(one.settings)} for one in points],
        "packets": packets,
        "recordings": {name: [one.digest for one in by] for name, by in clips.items()},
        "imu": next((one.recordings["imu"].digest for one in points if "imu" in one.recordings), None),
    }
    return DatasetPlan(out, points, about)


def _cutout_px(settings: LinkSettings) -> int:
    """Side of a film's cut-outs, by the array's image where it is nearest."""
    channel, signal = settings.channel, settings.signal
    last_m = min(channel.distance_m, channel.stop_m) if channel.moves else channel.distance_m
    # distance that an array is taken to have at least, for the size of its cut-outs: nearer it fills the frame
    nearest_m = max(last_m + min(one.z_offset_m for one in channel.arrays), 0.1)
    side = signal.side * channel.emitter.pitch_m * channel.camera.focal_px / nearest_m
    # pixels that a cut-out has more: a far array's blur and its surroundings
    size = math.ceil(min(CUTOUT_SIDES * side, 1e6)) + 8
    return min(size, max(channel.camera.width, channel.camera.height))


def _places(counts: Mapping[str, int]) -> Iterator[tuple[str, int]]:
    """The films of a combination of values: the split of each, and its place in it."""
    return ((split, place) for split in SPLITS for place in range(counts[split]))


def _counts(films: int, splits: Any) -> dict[str, int]:
    """Films by split, as near to the shares as whole films are; each split that has a share has one at least."""
    shares = list(splits) if isinstance(splits, (list, tuple)) else []
    whole = all(isinstance(one, int) and not isinstance(one, bool) and 0 <= one <= SEEDS for one in shares)
    if len(shares) != len(SPLITS) or not whole or not sum(shares):
        raise SettingsError(
            f"splits are the shares of train, validation and test, such as 80,10,10, not {_text(splits)}"
        )
    wanted = [share for share in shares if share]
    if films < len(wanted):
        raise SettingsError(f"{films} films of each kind cannot be split in {len(wanted)}: ask for more films")
    counts = [max(films * share // sum(shares), 1) if share else 0 for share in shares]
    for _ in range(abs(films - sum(counts))):
        # the split that lacks most gets one more, the one that has most above its share gives one
        lack = [films * share / sum(shares) - count for share, count in zip(shares, counts, strict=True)]
        if sum(counts) < films:
            counts[max(range(3), key=lambda k: lack[k] if shares[k] else -math.inf)] += 1
        else:
            counts[min(range(3), key=lambda k: lack[k] if counts[k] > 1 else math.inf)] -= 1
    return dict(zip(SPLITS, counts, strict=True))


def _clips(clips: Sequence[Recorded], splits: Sequence[str]) -> dict[str, list[Recorded]]:
    """Footage by split: the last clips are those of the later splits, all others of the first."""
    if not clips:
        return {}
    if len({one.digest for one in clips}) < len(clips):
        raise SettingsError("--background names the same footage twice: no scene may be in two splits")
    if len(clips) < len(splits):
        raise SettingsError(
            f"{len(splits)} splits need a footage each, not {len(clips)}: repeat --background, or write --splits 1,0,0"
        )
    first = len(clips) - len(splits) + 1
    return {splits[0]: list(clips[:first]), **{name: [clips[first + k]] for k, name in enumerate(splits[1:])}}


def _check_whole(name: str, value: Any, least: int, most: int) -> None:
    if not isinstance(value, (int, np.integer)) or isinstance(value, bool) or not least <= value <= most:
        raise SettingsError(f"the {name} is a whole number from {least} to {most}, not {shown(value)}")


def _text(splits: Any) -> str:
    """What was given for splits."""
    return ",".join(map(str, splits)) if isinstance(splits, (list, tuple)) else shown(splits)
