"""Identities: each filmed, and the identity that the receiver's detector finds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.channel import ImuTrace, Placement
from heliograph.channel.settings import ChannelSettings
from heliograph.experiments.detection.ablation import same
from heliograph.experiments.detection.clutter import Backdrop, ClutterFilm, film_moment
from heliograph.experiments.report import Context
from heliograph.link.settings import load_settings
from heliograph.measure.statistics import Count
from heliograph.receive.build import PLAIN_REGULARITY, search_parameters
from heliograph.receive.detect.detection import Detection
from heliograph.receive.detect.search import PyramidSearch
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.header import IDENTITIES
from heliograph.signal.settings import SignalSettings

BESIDE_M = (0.5, 1.2)
"""Range of the distance in m between the centres of two arrays in one view; their panels are 0.36 m wide."""


@dataclass(frozen=True, slots=True)
class Confusion:
    """Arrays filmed, by the identity shown and the identity found."""

    # (30, 31): a row an identity shown, a column an identity found; the last column: missed
    counts: NDArray[np.int64]

    @property
    def right(self) -> Count:
        """Arrays found with their own identity, among all; the rest is missed or wrong."""
        return Count(int(self.counts.sum()), int(np.trace(self.counts)))

    @property
    def wrong(self) -> Count:
        """Arrays found with another identity, among those found."""
        found = int(self.counts[:, :-1].sum())
        return Count(found, found - int(np.trace(self.counts)))

    @property
    def missed(self) -> Count:
        """Arrays not found, among all."""
        return Count(int(self.counts.sum()), int(self.counts[:, -1].sum()))


@dataclass(frozen=True, slots=True)
class IdentityFilms:
    """Films of an identity at a distance, before each scene in turn."""

    # Distance from camera to arrays in m
    distance_m: float
    # Identity that is filmed, 0 to 29
    shown: int
    # Whether an array of another identity stands in the same view
    beside: bool
    # Number of films, 0 or more
    repeats: int
    # Scenes behind the array; the identity's number says which comes first
    scenes: Sequence[Backdrop]
    # Recorded motion; None: a road of class C
    imu: ImuTrace | None
    # Seed of all films, 0 or more
    seed: int


def confusion(
    distances: Sequence[float],
    scenes: Mapping[str, Backdrop],
    repeats: int,
    imu: ImuTrace | None,
    context: Context,
    span: tuple[float, float],
    identities: Sequence[int] = range(IDENTITIES),
    *,
    beside: bool = False,
) -> dict[float, Confusion]:
    """Film every identity at every distance, the car at rest with its shake."""
    backs = tuple(scenes.values())
    batches = [
        IdentityFilms(z, one, beside, repeats, backs, imu, context.seed) for z in distances for one in identities
    ]
    title = "identities, two in view" if beside else "identities"
    counts = {z: np.zeros((IDENTITIES, IDENTITIES + 1), dtype=np.int64) for z in distances}
    for batch, pairs in zip(batches, context.each(title, film_identity, batches, span), strict=True):
        for shown, found in pairs:
            counts[batch.distance_m][shown, found] += 1
    return {z: Confusion(one) for z, one in counts.items()}


def film_identity(batch: IdentityFilms) -> list[tuple[int, int]]:
    """Identity shown and identity found, 30 for none, of each array in the films."""
    pairs: list[tuple[int, int]] = []
    for repeat in range(batch.repeats):
        kind = [1] if batch.beside else []
        rng = np.random.default_rng([batch.seed, round(10 * batch.distance_m), batch.shown, repeat, *kind])
        shown, places = [batch.shown], [Placement(x_m=0.0, y_m=0.0)]
        if batch.beside:
            shown.append(int((batch.shown + rng.integers(1, IDENTITIES)) % IDENTITIES))
            places = _side_by_side(rng)
        scene = batch.scenes[(batch.shown + repeat) % len(batch.scenes)](rng)
        film = film_moment(scene, rng, batch.imu, batch.distance_m, "m_sequence", shown, small_camera(places))
        pairs += zip(shown, identities_seen(film), strict=True)
    return pairs


def _side_by_side(rng: np.random.Generator) -> list[Placement]:
    """Two places about the optical axis, `BESIDE_M` apart in a row, in any order, at heights of their own."""
    half = 0.5 * float(rng.choice([-1, 1]) * rng.uniform(*BESIDE_M))
    return [Placement(x_m=x, y_m=float(rng.uniform(-0.2, 0.2))) for x in (-half, half)]


def small_camera(places: Sequence[Placement]) -> ChannelSettings:
    """The reference link at rest, with a part of its sensor about the arrays."""
    channel = load_settings("paper", {"channel": {"speed_m_s": 0.0, "camera": {"width": 256, "height": 192}}}).channel
    return replace(channel, arrays=tuple(places))


def identities_seen(film: ClutterFilm) -> list[int]:
    """Identity that the detector gives each of the film's arrays; 30 where it misses one."""
    # least side in px that is searched for: an array 150 m away has 6.2 px, less than the receiver's default of 8
    every = detections(film, 5.0)
    near = ([one for one in every if same(one.fit.pose, truth)] for truth in film.truths)
    return [max(found, key=lambda one: one.score).identity if found else IDENTITIES for found in near]


def detections(film: ClutterFilm, smallest_px: float | None = None) -> list[Detection]:
    """Detections of the receiver's detector in a film."""
    settings = ReceiveSettings()
    if smallest_px:
        settings = replace(settings, detect=replace(settings.detect, min_side_px=smallest_px))
    signal = SignalSettings()
    detector = PyramidSearch(search_parameters(settings, signal, PLAIN_REGULARITY), signal)
    return [one for frame in film.frames for one in detector.search(frame)]
