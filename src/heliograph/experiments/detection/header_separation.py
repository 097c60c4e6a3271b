"""Distances between headers with the blur of the reference link, by computation.

The signal is the difference of a header and the inverse, +-0.8 of full scale. Each LED is blurred by the disc (as a
Gaussian of the same variance), by a Gaussian of 0.5 pixels and by the pixel. Two headers are compared at the most
similar relative shift of up to 1.5 cells; formats of a later header pair are compared with no shift. The tables state
the largest correlation of two headers and the largest magnitude, the most similar headers with the distance in standard
deviations of pixel noise, and the distance of the most similar formats.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import erfc

from heliograph.base.arrays import Floats
from heliograph.experiments.report import Table
from heliograph.signal.formats import DIMMED, words
from heliograph.signal.header import CELLS, IDENTITIES, all_header_cells

SIDE = 16
DISTANCES_M = (25.0, 40.0, 60.0, 80.0, 100.0, 120.0, 150.0, 180.0, 220.0)


@dataclass(frozen=True, slots=True)
class Separation:
    """Similarity of the headers at a distance."""

    distance_m: float
    # Pitch of the LEDs in px
    pitch_px: float
    # Largest correlation of two headers, -1 to 1, and largest magnitude
    correlation: float
    magnitude: float
    # Identities of the most similar headers
    closest: tuple[int, int]
    # Distance of these headers, and of the most similar formats of any identity, in pixel noise
    headers: float
    formats: float


def blur_overlap(t: Floats, pitch_px: float) -> Floats:
    """Overlap of two blurred points along an axis, with integral 1.

    The autocorrelation of box * Gaussian: a triangle of half width 1, blurred by a Gaussian of variance 2 sigma^2.
    """
    # a disc of radius r has the variance r^2 / 4 along an axis; the diameter is a quarter of the pitch
    variance = 2 * (0.5**2 + (0.25 * pitch_px / 2) ** 2 / 4)

    def second_integral(x: Floats) -> Floats:
        # of the Gaussian: x Phi(x) + sigma^2 phi(x)
        density = np.exp(-(x**2) / (2 * variance)) / np.sqrt(2 * np.pi * variance)
        integral: Floats = x * 0.5 * erfc(-x / np.sqrt(2 * variance)) + variance * density
        return integral

    overlap: Floats = second_integral(t + 1) - 2 * second_integral(t) + second_integral(t - 1)
    return overlap


def cell_overlaps(shifts_px: Floats, pitch_px: float) -> Floats:
    """Overlap of cell a with shifted cell b along an axis, (shifts, 4, 4)."""
    led = np.arange(SIDE) * pitch_px
    overlap = blur_overlap(led[:, None] - led[None] - shifts_px[:, None, None], pitch_px)
    width = SIDE // CELLS
    cells: Floats = overlap.reshape(-1, CELLS, width, CELLS, width).sum((2, 4))
    return cells


def header_products(shifts_px: Floats, pitch_px: float) -> Floats:
    """Inner products of the images of header i and shifted header j, in full scales squared."""
    h = all_header_cells().astype(np.float64)
    axis = cell_overlaps(shifts_px, pitch_px)
    down = np.einsum("iab,sac->sicb", h, axis)
    both = np.einsum("sicb,tbd->sticd", down, axis).reshape(len(axis), len(axis), IDENTITIES, -1)
    products: Floats = (0.8 * pitch_px**2) ** 2 * both @ h.reshape(IDENTITIES, -1).T
    return products


def separation(distance_m: float, steps: int = 60) -> Separation:
    """Similarity of the headers at a distance."""
    # 35 mm lens, 20 mm pitch, 12 um pixels
    pitch_px = 58.3 / distance_m
    # up to 1.5 cells
    shifts = np.linspace(-1, 1, 2 * steps + 1) * 1.5 * SIDE / CELLS * pitch_px
    products = header_products(shifts, pitch_px)
    energy = np.diagonal(products[steps, steps])
    correlation = products / np.sqrt(energy[:, None] * energy)
    others = ~np.eye(IDENTITIES, dtype=bool)
    squared = (energy[:, None] + energy - 2 * products.max((0, 1)))[others]
    i, j = sorted(map(int, np.argwhere(others)[np.argmin(squared)]))
    best, magnitude = correlation[..., others].max(), np.abs(correlation[..., others]).max()
    formats = format_separation(pitch_px)
    return Separation(distance_m, pitch_px, float(best), float(magnitude), (i, j), _in_noise(squared), formats)


def format_separation(pitch_px: float) -> float:
    """Distance of the most similar formats of all identities in pixel noise; a single pair, known array and pose."""
    axis = cell_overlaps(np.zeros(1), pitch_px)[0]
    gram = (0.8 * pitch_px**2) ** 2 * np.kron(axis, axis)
    contrast = np.where(words(), DIMMED, 1.0)
    smallest = np.inf
    for header in all_header_cells().reshape(IDENTITIES, -1):
        shown = header * contrast
        products = shown @ gram @ shown.T
        energy = np.diagonal(products)
        squared = energy[:, None] + energy - 2 * products
        smallest = min(smallest, _in_noise(squared[~np.eye(len(shown), dtype=bool)]))
    return smallest


def _in_noise(squared: Floats) -> float:
    """Smallest of squared distances, as a distance in pixel noise."""
    # the difference of two frames has twice the variance; the noise of a pixel is 0.006 of full scale
    return float(np.sqrt(squared.min() / 2) / 0.006)


def tables(found: Sequence[Separation]) -> list[Table]:
    """Headers and formats by distance."""
    rows = [
        (
            *(f"{s.distance_m:g}", f"{s.pitch_px:.2f}", f"{s.correlation:.3f}", f"{s.magnitude:.3f}"),
            *(f"{s.closest[0]}, {s.closest[1]}", f"{s.headers:.0f}"),
        )
        for s in found
    ]
    return [
        Table("Headers", ["Z (m)", "pitch (px)", "correlation", "magnitude", "closest two", "distance (noises)"], rows),
        Table("Formats", ["Z (m)", "distance (noises)"], [(f"{s.distance_m:g}", f"{s.formats:.0f}") for s in found]),
    ]
