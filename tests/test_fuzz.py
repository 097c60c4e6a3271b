"""Damaged and random input: each parser returns a value or raises a clear error."""

import random
from pathlib import Path

import pytest
from fuzz_films import Seeds
from hypothesis import given
from hypothesis import strategies as st
from parser_fuzz import mutated, outcome, seeds
from properties import examples

from heliograph.base.errors import HeliographError
from heliograph.link.settings import load_settings
from heliograph.media.slots import SUFFIXES

NAMES = [
    "film.h5", "film.mkv", "film.nut", "film.mp4", "film.avi", "film.y4m", "film.cine", "film.cih", "film.cihx",
    "film.tif", "film.npy", "film.png", "film.jpg", "shots.png", "shots.jpg", "shots.tif",
    *[f"slots{suffix}" for suffix in SUFFIXES],
    "truth", "trace", "settings", "set", "record", "note", "block", "road", "vary",
]  # fmt: skip


@pytest.fixture(scope="module")
def parsers(tmp_path_factory: pytest.TempPathFactory) -> Seeds:
    return seeds(tmp_path_factory.mktemp("seeds"))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.slow
def test_a_parser_ends_in_a_value_or_a_clear_error(
    name: str, parsers: Seeds, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    parser, good = parsers[name]
    rng = random.Random(7)
    found = {outcome(parser, mutated(rng.choice(good), rng), tmp_path) for _ in range(40)}
    assert found <= {"value", "error"}
    if name.endswith(".tif"):  # tifffile and OpenCV print nothing
        assert capfd.readouterr().err == ""


def test_a_crash_of_a_parser_is_a_fault(tmp_path: Path) -> None:
    def crash(data: bytes, folder: Path) -> object:
        raise ZeroDivisionError("by chance")

    assert outcome(crash, b"", tmp_path) == "ZeroDivisionError: by chance"


KEYS = st.sampled_from(["channel", "distance_m", "arrays", "signal", "rate", "receive", "custom", "0", "x_m", "side"])
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=3),
    max_leaves=8,
)


@examples(30)
@given(tree=st.dictionaries(KEYS, VALUES, max_size=3))
@pytest.mark.slow
def test_any_tree_is_settings_or_a_clear_error(tree: dict[str, object]) -> None:
    try:
        load_settings("static", tree)
    except HeliographError as error:
        assert "\n" not in str(error)  # noqa: PT017  # either outcome is right
