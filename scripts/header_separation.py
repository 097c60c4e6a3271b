"""How far the headers of different identities stay apart under the reference link's blur.

    python scripts/header_separation.py

Writes a Markdown table, and one of how far apart the formats are that a later header pair may name. Image of a header
less that of its inverse, +-0.8 of full scale (all-on array 0.8): every LED blurred by its disc (as the Gaussian of the
same variance), by a Gaussian of 0.5 pixels and by the pixel's box. Two headers are compared at the relative shift,
up to 1.5 cells either way, that makes them most alike.
"""

import argparse
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from heliograph.signal.formats import DIMMED, words
from heliograph.signal.header import CELLS, IDENTITIES, all_header_cells

Floats = NDArray[np.float64]

SIDE = 16
PITCH_PX_M = 58.3
"""Pitch of the LEDs in the image times the distance: 35 mm lens, 20 mm pitch, 12 um pixels."""
EMITTER = 0.25
"""Diameter of an emitter by the pitch: 5 mm by 20 mm."""
BLUR_PX = 0.5
AMPLITUDE = 0.8
NOISE = 0.006
"""Noise of a pixel in a frame, of full scale."""
DISTANCES_M = (25, 40, 60, 80, 100, 120, 150, 180, 220)
REACH_CELLS = 1.5


def blur_overlap(t: Floats, pitch_px: float) -> Floats:
    """Overlap of two blurred points of light at a distance of t pixels along one axis; its integral is 1.

    The autocorrelation of box * Gaussian: a triangle of half width 1, blurred by a Gaussian of variance 2 sigma^2.
    """
    # a disc of radius r has the variance r^2 / 4 along an axis
    variance = 2 * (BLUR_PX**2 + (EMITTER * pitch_px / 2) ** 2 / 4)

    def second_integral(x: Floats) -> Floats:
        # of the Gaussian: x Phi(x) + sigma^2 phi(x)
        density = np.exp(-(x**2) / (2 * variance)) / np.sqrt(2 * np.pi * variance)
        integral: Floats = x * 0.5 * erfc(-x / np.sqrt(2 * variance)) + variance * density
        return integral

    overlap: Floats = second_integral(t + 1) - 2 * second_integral(t) + second_integral(t - 1)
    return overlap


def cell_overlaps(shifts_px: Floats, pitch_px: float) -> Floats:
    """Overlap of cell a with cell b moved by each shift, along one axis: (shifts, 4, 4)."""
    led = np.arange(SIDE) * pitch_px
    overlap = blur_overlap(led[:, None] - led[None] - shifts_px[:, None, None], pitch_px)
    width = SIDE // CELLS
    cells: Floats = overlap.reshape(-1, CELLS, width, CELLS, width).sum((2, 4))
    return cells


def header_products(shifts_px: Floats, pitch_px: float) -> Floats:
    """Sum over all pixels of image i times image j moved: (shifts down, shifts right, 30, 30), in full scales^2."""
    h = all_header_cells().astype(np.float64)
    axis = cell_overlaps(shifts_px, pitch_px)
    down = np.einsum("iab,sac->sicb", h, axis)
    both = np.einsum("sicb,tbd->sticd", down, axis).reshape(len(axis), len(axis), IDENTITIES, -1)
    products: Floats = (AMPLITUDE * pitch_px**2) ** 2 * both @ h.reshape(IDENTITIES, -1).T
    return products


def separation(distance_m: float, steps: int = 60) -> tuple[float, float, tuple[int, int], float]:
    """Largest correlation, largest magnitude of one, the closest two identities, their distance in noises."""
    pitch_px = PITCH_PX_M / distance_m
    shifts = np.linspace(-1, 1, 2 * steps + 1) * REACH_CELLS * SIDE / CELLS * pitch_px
    products = header_products(shifts, pitch_px)
    energy = np.diagonal(products[steps, steps])
    correlation = products / np.sqrt(energy[:, None] * energy)
    others = ~np.eye(IDENTITIES, dtype=bool)
    squared = (energy[:, None] + energy - 2 * products.max((0, 1)))[others]
    closest = np.argwhere(others)[np.argmin(squared)]
    # a difference of two frames has twice the variance of a frame
    apart = float(np.sqrt(squared.min() / 2) / NOISE)
    best, either = correlation[..., others].max(), np.abs(correlation[..., others]).max()
    i, j = sorted(map(int, closest))
    return float(best), float(either), (i, j), apart


def table(distances_m: Sequence[float]) -> str:
    """The table of `separation` by distance."""
    lines = [
        "| Z (m) | pitch (px) | correlation | magnitude | closest two | distance (noises) |",
        "|---|---|---|---|---|---|",
    ]
    for z in distances_m:
        best, either, (i, j), apart = separation(z)
        row = (f"{z:g}", f"{PITCH_PX_M / z:.2f}", f"{best:.3f}", f"{either:.3f}", f"{i}, {j}", f"{apart:.0f}")
        lines.append(f"| {' | '.join(row)} |")
    return "\n".join(lines)


def format_separation(distance_m: float) -> float:
    """Distance in noises of the two formats most alike, of all identities; one pair, array and pose known."""
    pitch_px = PITCH_PX_M / distance_m
    axis = cell_overlaps(np.zeros(1), pitch_px)[0]
    gram = (AMPLITUDE * pitch_px**2) ** 2 * np.kron(axis, axis)
    contrast = np.where(words(), DIMMED, 1.0)
    least = np.inf
    for header in all_header_cells().reshape(IDENTITIES, -1):
        shown = header * contrast
        products = shown @ gram @ shown.T
        energy = np.diagonal(products)
        squared = energy[:, None] + energy - 2 * products
        least = min(least, float(squared[~np.eye(len(shown), dtype=bool)].min()))
    return float(np.sqrt(least / 2) / NOISE)


def format_table(distances_m: Sequence[float]) -> str:
    """The table of `format_separation` by distance."""
    rows = [f"| {z:g} | {format_separation(z):.0f} |" for z in distances_m]
    return "\n".join(["| Z (m) | distance (noises) |", "|---|---|", *rows])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("distances_m", nargs="*", type=float, default=DISTANCES_M)
    distances = parser.parse_args().distances_m
    print(f"{table(distances)}\n\n{format_table(distances)}")
