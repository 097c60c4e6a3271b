"""Truth files round-trip for arbitrary array motion."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from link_packets import small
from properties import examples

from heliograph.channel import NoiseModel, Truth
from heliograph.channel.truth import ArrayTruth
from heliograph.link.settings import LinkSettings
from heliograph.link.truth import TruthWriter, open_truth
from heliograph.signal.settings import LAYERS

SETTINGS = {
    1: small("channel.duration_s=0.01"),
    2: small("channel.arrays=[{x_m=-1.0, y_m=0.0}, {x_m=1.0, y_m=0.0}]", "transmit.identities=[4, 21]"),
}
NUMBERS = st.floats(-1e6, 1e6, width=32)

ARRAYS = st.builds(
    ArrayTruth,
    x=NUMBERS,
    y=NUMBERS,
    pitch_px=NUMBERS,
    roll_rad=NUMBERS,
    homography=st.lists(NUMBERS, min_size=9, max_size=9).map(lambda values: np.reshape(values, (3, 3))),
    distance_m=NUMBERS,
    visible=st.booleans(),
    patterns=st.lists(st.integers(0, 2**31 - 1), max_size=3).map(lambda numbers: tuple(sorted(numbers))),
)


@st.composite
def films(draw: st.DrawFn) -> tuple[LinkSettings, list[Truth]]:
    """Draw settings with one or two arrays, and frames with arbitrary times and numbers."""
    count = draw(st.sampled_from(sorted(SETTINGS)))
    settings = SETTINGS[count]
    truths = st.builds(
        Truth,
        index=st.integers(0, 2**62),
        time_s=st.floats(-1e9, 1e9),
        arrays=st.tuples(*[ARRAYS] * count),
        noise=st.just(NoiseModel(settings.channel.sensor)),
    )
    return settings, draw(st.lists(truths, min_size=1, max_size=6))


@st.composite
def messages(draw: st.DrawFn, arrays: int) -> list[dict[str, list[bytes]]]:
    """Draw messages per array and layer; a layer may be empty."""
    some = st.lists(st.binary(max_size=40), max_size=3)
    return [draw(st.fixed_dictionaries({}, optional=dict.fromkeys(LAYERS, some))) for _ in range(arrays)]


def write(path: Path, settings: LinkSettings, sent: Any, seed: int, film_id: str, truths: list[Truth]) -> None:
    writer = TruthWriter(path, settings, sent, seed, film_id)
    for truth in truths:
        writer.add(truth)
    with writer.finishing():
        pass


@examples(50)
@given(film=films(), data=st.data(), seed=st.integers(0, 2**63), film_id=st.text(max_size=8))
@pytest.mark.slow
def test_a_film_and_back(film: tuple[LinkSettings, list[Truth]], data: st.DataObject, seed: int, film_id: str) -> None:
    settings, truths = film
    sent = data.draw(messages(len(settings.channel.arrays)))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mkv.truth.npz"
        write(path, settings, sent, seed, film_id, truths)
        found = open_truth(path)
        rows = list(found.rows())
    assert (found.settings, found.seed, found.film_id) == (settings, seed, film_id)
    assert list(found.messages) == [{name: by.get(name, []) for name in LAYERS} for by in sent]
    assert len(rows) == len(truths)
    for row, truth in zip(rows, truths, strict=True):
        assert (int(row["index"]), float(row["time_s"])) == (truth.index, truth.time_s)
        for got, array in zip(row["arrays"], truth.arrays, strict=True):
            for name in ("x", "y", "pitch_px", "roll_rad", "distance_m", "visible"):
                assert got[name] == getattr(array, name), name
            assert np.array_equal(got["homography"], array.homography)
            ends = (array.patterns[0], array.patterns[-1]) if array.patterns else (-1, -1)
            assert (got["pattern"], got["last_pattern"]) == ends


def test_rows_are_read_in_parts(tmp_path: Path) -> None:
    """Write more rows than a 4096-row chunk, with a partial last chunk."""
    settings, count = SETTINGS[1], 8197
    array = ArrayTruth(1.0, 2.0, 3.0, 0.0, np.eye(3), 50.0, True, ())
    path, noise = tmp_path / "film.truth.npz", NoiseModel(settings.channel.sensor)
    write(path, settings, [{}], 0, "", [Truth(k, 1e-3 * k, (array,), noise) for k in range(count)])
    assert [int(row["index"]) for row in open_truth(path).rows()] == list(range(count))
