"""Distances between the headers of different identities under the reference link's blur, by computation.

The image is that of a header less that of its inverse, +-0.8 of full scale (all-on array 0.8): every LED blurred by its
disc (as the Gaussian of the same variance), by a Gaussian of 0.5 pixels and by the pixel's box. Two headers are
compared at the relative shift, up to 1.5 cells either way, at which they are most alike. Formats that a later header
pair names are compared without a shift.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from scipy.special import erfc

from heliograph.base.arrays import Floats
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table
from heliograph.signal.formats import DIMMED, words
from heliograph.signal.header import CELLS, IDENTITIES, all_header_cells

SIDE = 16
AMPLITUDE = 0.8
DISTANCES_M = (25.0, 40.0, 60.0, 80.0, 100.0, 120.0, 150.0, 180.0, 220.0)

TEXT = (
    "Headers of all identities under the reference link's blur, by computation: the largest correlation of two of them "
    "at any shift up to 1.5 cells, its largest magnitude, the two most alike and the distance between them in standard "
    "deviations of a pixel's noise; and the distance of the two formats most alike that a later header pair may name."
)


@dataclass(frozen=True, slots=True)
class Separation:
    """Likeness of the headers at a distance."""

    # Distance from camera to array in m
    distance_m: float
    # Pitch of the LEDs in px
    pitch_px: float
    # correlation, magnitude: largest correlation of two headers, -1 to 1, and largest magnitude of one, 0 to 1
    correlation: float
    magnitude: float
    # The two identities with the least distance
    closest: tuple[int, int]
    # headers, formats: distance of these two, and of the two formats most alike of any identity, by the noise of a
    # pixel
    headers: float
    formats: float


def blur_overlap(t: Floats, pitch_px: float) -> Floats:
    """Overlap of two blurred points of light along one axis; its integral is 1.

    The autocorrelation of box * Gaussian: a triangle of half width 1, blurred by a Gaussian of variance 2 sigma^2.
    """
    # a disc of radius r has the variance r^2 / 4 along an axis
    # diameter of an emitter by the pitch: 5 mm by 20 mm
    variance = 2 * (0.5**2 + (0.25 * pitch_px / 2) ** 2 / 4)

    def second_integral(x: Floats) -> Floats:
        # of the Gaussian: x Phi(x) + sigma^2 phi(x)
        density = np.exp(-(x**2) / (2 * variance)) / np.sqrt(2 * np.pi * variance)
        integral: Floats = x * 0.5 * erfc(-x / np.sqrt(2 * variance)) + variance * density
        return integral

    overlap: Floats = second_integral(t + 1) - 2 * second_integral(t) + second_integral(t - 1)
    return overlap


def cell_overlaps(shifts_px: Floats, pitch_px: float) -> Floats:
    """Overlap of cell a with cell b moved by each shift, along one axis. Returns (shifts, 4, 4), by a and b."""
    led = np.arange(SIDE) * pitch_px
    overlap = blur_overlap(led[:, None] - led[None] - shifts_px[:, None, None], pitch_px)
    width = SIDE // CELLS
    cells: Floats = overlap.reshape(-1, CELLS, width, CELLS, width).sum((2, 4))
    return cells


def header_products(shifts_px: Floats, pitch_px: float) -> Floats:
    """Sum over all pixels of the image of header i times that of header j moved, in full scales squared."""
    h = all_header_cells().astype(np.float64)
    axis = cell_overlaps(shifts_px, pitch_px)
    down = np.einsum("iab,sac->sicb", h, axis)
    both = np.einsum("sicb,tbd->sticd", down, axis).reshape(len(axis), len(axis), IDENTITIES, -1)
    products: Floats = (AMPLITUDE * pitch_px**2) ** 2 * both @ h.reshape(IDENTITIES, -1).T
    return products


def separation(distance_m: float, steps: int = 60) -> Separation:
    """Likeness of the headers at a distance."""
    # pitch of the LEDs in the image in px times the distance in m: 35 mm lens, 20 mm pitch, 12 um pixels
    pitch_px = 58.3 / distance_m
    # largest shift in cells
    shifts = np.linspace(-1, 1, 2 * steps + 1) * 1.5 * SIDE / CELLS * pitch_px
    products = header_products(shifts, pitch_px)
    energy = np.diagonal(products[steps, steps])
    correlation = products / np.sqrt(energy[:, None] * energy)
    others = ~np.eye(IDENTITIES, dtype=bool)
    squared = (energy[:, None] + energy - 2 * products.max((0, 1)))[others]
    i, j = sorted(map(int, np.argwhere(others)[np.argmin(squared)]))
    best, either = correlation[..., others].max(), np.abs(correlation[..., others]).max()
    return Separation(
        distance_m, pitch_px, float(best), float(either), (i, j), _noises(squared), format_separation(pitch_px)
    )


def format_separation(pitch_px: float) -> float:
    """Distance in noises of the two formats most alike, of all identities; one pair, array and pose known."""
    axis = cell_overlaps(np.zeros(1), pitch_px)[0]
    gram = (AMPLITUDE * pitch_px**2) ** 2 * np.kron(axis, axis)
    contrast = np.where(words(), DIMMED, 1.0)
    least = np.inf
    for header in all_header_cells().reshape(IDENTITIES, -1):
        shown = header * contrast
        products = shown @ gram @ shown.T
        energy = np.diagonal(products)
        squared = energy[:, None] + energy - 2 * products
        least = min(least, _noises(squared[~np.eye(len(shown), dtype=bool)]))
    return least


def _noises(squared: Floats) -> float:
    """Least distance by the noise, of squared distances."""
    # a difference of two frames has twice the variance of a frame
    # noise of a pixel in a frame, by full scale
    return float(np.sqrt(squared.min() / 2) / 0.006)


def tables(found: Sequence[Separation]) -> list[Table]:
    """The headers and the formats by distance."""
    rows = [
        (
            f"{one.distance_m:g}",
            f"{one.pitch_px:.2f}",
            f"{one.correlation:.3f}",
            f"{one.magnitude:.3f}",
            f"{one.closest[0]}, {one.closest[1]}",
            f"{one.headers:.0f}",
        )
        for one in found
    ]
    return [
        Table("Headers", ["Z (m)", "pitch (px)", "correlation", "magnitude", "closest two", "distance (noises)"], rows),
        Table("Formats", ["Z (m)", "distance (noises)"], [(f"{z.distance_m:g}", f"{z.formats:.0f}") for z in found]),
    ]


def run(context: Context) -> ExperimentResult:
    """Compare all headers and formats."""
    found = [separation(z) for z in (DISTANCES_M[::4] if context.quick else DISTANCES_M)]
    far = found[-1]
    return ExperimentResult(
        key="header-separation",
        title="Distances between headers",
        text=TEXT,
        findings=[
            Finding(
                "Asked: the distance between the two headers most alike.",
                f"At {far.distance_m:g} m {far.headers:.0f} standard deviations of a pixel's noise, between identities "
                f"{far.closest[0]} and {far.closest[1]}; {far.formats:.0f} between two formats.",
                "shown",
            )
        ],
        tables=tables(found),
        data={"separation": [asdict(one) for one in found]},
    )
