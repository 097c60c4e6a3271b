"""Light within an exposure: fraction, centroid and variance against numerical integration."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from heliograph.base.arrays import Floats
from heliograph.channel.exposure import Lit

FINE = 4000
CUTS = st.lists(st.floats(0.01, 0.99), max_size=6, unique=True)


def by_steps(lit: Lit, start_s: float, end_s: float) -> tuple[Floats, Floats, Floats]:
    """Return lit fraction, centroid from mid-exposure and variance per LED by numerical integration."""
    at = start_s + (end_s - start_s) * (np.arange(FINE) + 0.5) / FINE
    shines = ((at >= lit.start_s[:, None]) & (at < lit.end_s[:, None])).astype(float)
    light = np.tensordot(lit.on, shines, (0, 0))
    mass, late = np.maximum(light.sum(-1), 1e-30), at - (start_s + end_s) / 2
    centroid = (light * late).sum(-1) / mass
    return light.mean(-1), centroid, (light * late**2).sum(-1) / mass - centroid**2


@examples(40)
@given(CUTS.filter(bool), st.sampled_from([0.0, 0.3]), st.integers(0, 99))
def test_moments_are_those_of_the_light(cuts: list[float], start_s: float, seed: int) -> None:
    edges = start_s + 1e-3 * np.array([0.0, *sorted(cuts), 1.0])
    on = (np.random.default_rng(seed).random((len(edges) - 1, 2, 2)) < 0.6).astype(float)
    lit = Lit(edges[:-1], edges[1:], on, (0, 1))
    part, late, spread = lit.moments(start_s, start_s + 1e-3)
    expected, shines = by_steps(lit, start_s, start_s + 1e-3), on.any(0)
    assert part == pytest.approx(expected[0], abs=1e-3)
    assert late[shines] == pytest.approx(expected[1][shines], abs=2e-6)
    assert spread[shines] == pytest.approx(expected[2][shines], abs=2e-9)
    assert (part[~shines] == 0).all()


@examples(30)
@given(CUTS, st.floats(0.02, 2.0))
def test_pieces_split_are_the_same_light(cuts: list[float], longest: float) -> None:
    edges = 1e-3 * np.array([0.0, *sorted(cuts), 1.0])
    on = (np.random.default_rng(0).random((len(edges) - 1, 2, 2)) < 0.6).astype(float)
    lit = Lit(edges[:-1], edges[1:], on, (0, 1))
    split = lit.split(longest * 1e-3)
    assert (split.end_s - split.start_s).max() <= longest * 1e-3 * (1 + 1e-6)
    assert split.patterns == lit.patterns
    for one, other in zip(split.moments(0.0, 1e-3), lit.moments(0.0, 1e-3), strict=True):
        assert one == pytest.approx(other, abs=1e-12)
