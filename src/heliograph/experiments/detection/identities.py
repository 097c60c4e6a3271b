"""Films of all identities, and the identities found by the detector of the receiver."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.channel import ImuTrace, Placement
from heliograph.channel.settings import ChannelSettings
from heliograph.experiments.detection.ablation import is_same
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


@dataclass(frozen=True, slots=True)
class Confusion:
    """Confusion matrix of identities."""

    # (30, 31): shown identities in rows, found identities in columns; the last column: missed
    counts: NDArray[np.int64]

    @property
    def right(self) -> Count:
        """Arrays found with the correct identity, of all arrays."""
        return Count(int(self.counts.sum()), int(np.trace(self.counts)))

    @property
    def wrong(self) -> Count:
        """Arrays found with another identity, of all arrays found."""
        found = int(self.counts[:, :-1].sum())
        return Count(found, found - int(np.trace(self.counts)))

    @property
    def missed(self) -> Count:
        """Missed arrays, of all arrays."""
        return Count(int(self.counts.sum()), int(self.counts[:, -1].sum()))


@dataclass(frozen=True, slots=True)
class IdentityFilms:
    """Films of an identity at a distance, with a different scene for each."""

    distance_m: float
    # Identity of the array
    shown: int
    # True if an array of another identity is in the same view
    beside: bool
    # Number of films
    repeats: int
    scenes: Sequence[Backdrop]
    # Recorded motion; None: a road of class C
    imu: ImuTrace | None
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
    """Film each identity at each distance, from a car at rest with shake."""
    backdrops = tuple(scenes.values())
    batches = [
        IdentityFilms(z, identity, beside, repeats, backdrops, imu, context.seed)
        for z in distances
        for identity in identities
    ]
    title = "identities, two in view" if beside else "identities"
    counts = {z: np.zeros((IDENTITIES, IDENTITIES + 1), dtype=np.int64) for z in distances}
    for batch, pairs in zip(batches, context.each(title, film_identity, batches, span), strict=True):
        for shown, found in pairs:
            counts[batch.distance_m][shown, found] += 1
    return {z: Confusion(matrix) for z, matrix in counts.items()}


def film_identity(batch: IdentityFilms) -> list[tuple[int, int]]:
    """Shown and found identity (30: none) of each array in the films."""
    pairs: list[tuple[int, int]] = []
    for repeat in range(batch.repeats):
        kind = [1] if batch.beside else []
        rng = np.random.default_rng([batch.seed, round(10 * batch.distance_m), batch.shown, repeat, *kind])
        shown, places = [batch.shown], [Placement(x_m=0.0, y_m=0.0)]
        if batch.beside:
            shown.append(int((batch.shown + rng.integers(1, IDENTITIES)) % IDENTITIES))
            # panels are 0.36 m wide
            half = 0.5 * float(rng.choice([-1, 1]) * rng.uniform(0.5, 1.2))
            places = [Placement(x_m=x, y_m=float(rng.uniform(-0.2, 0.2))) for x in (-half, half)]
        scene = batch.scenes[(batch.shown + repeat) % len(batch.scenes)](rng)
        film = film_moment(scene, rng, batch.imu, batch.distance_m, "m_sequence", shown, small_camera(places))
        pairs += zip(shown, identities_seen(film), strict=True)
    return pairs


def small_camera(places: Sequence[Placement]) -> ChannelSettings:
    """Reference link at rest, with a section of the sensor around the arrays."""
    channel = load_settings("paper", {"channel": {"speed_m_s": 0.0, "camera": {"width": 256, "height": 192}}}).channel
    return replace(channel, arrays=tuple(places))


def identities_seen(film: ClutterFilm) -> list[int]:
    """Identity found for each array of a film; 30: missed."""
    # the side is 6.2 px at 150 m, less than the default limit of the receiver
    every = detections(film, 5.0)
    near = ([one for one in every if is_same(one.fit.pose, truth)] for truth in film.truths)
    return [max(found, key=lambda one: one.score).identity if found else IDENTITIES for found in near]


def detections(film: ClutterFilm, min_side_px: float | None = None) -> list[Detection]:
    """Detections of the receiver in a film."""
    settings, signal = ReceiveSettings(), SignalSettings()
    if min_side_px:
        settings = replace(settings, detect=replace(settings.detect, min_side_px=min_side_px))
    detector = PyramidSearch(search_parameters(settings, signal, PLAIN_REGULARITY), signal)
    return [one for frame in film.frames for one in detector.search(frame)]
