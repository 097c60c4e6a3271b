"""Sweep values: arbitrary ranges, lists and grids."""

import itertools
from decimal import Decimal
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from heliograph.base.toml_text import to_toml
from heliograph.sweeps.plan import grid, nested, parse_vary

DECIMALS = st.decimals(-1000, 1000, places=3)
STEPS = st.decimals("0.001", 100, places=3)
TEXTS = st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1, max_size=10)
VALUES = (
    st.booleans()
    | st.integers(-(10**9), 10**9)
    | st.floats(-1e9, 1e9)
    | TEXTS
    | st.lists(st.integers(-(2**63), 2**63 - 1), max_size=3)
)


def written(value: Any) -> str:
    """Format a value as TOML."""
    return to_toml({"v": value}).removeprefix("v = ").rstrip("\n")


@examples(100)
@given(first=DECIMALS, count=st.integers(0, 60), step=STEPS, down=st.booleans())
def test_a_range_has_its_ends_and_even_steps(first: Decimal, count: int, step: Decimal, down: bool) -> None:
    step = -step if down else step
    last = first + count * step
    key, values = parse_vary(f"channel.distance_m={first}:{last}:{step}")
    assert key == "channel.distance_m"
    assert values == [float(first + k * step) for k in range(count + 1)]
    # integers stay integers
    whole = first == first.to_integral_value() and step == step.to_integral_value()
    assert {type(value) for value in values} == {int if whole else float}
    # an end between two steps is excluded
    assert parse_vary(f"a={first}:{last + step / 2}:{step}")[1] == values


@examples(100)
@given(values=st.lists(VALUES, min_size=1, max_size=6))
def test_a_list_holds_its_values_as_they_are(values: list[Any]) -> None:
    found = parse_vary(f" a.b = {','.join(map(written, values))}")
    assert found == ("a.b", values)
    assert list(map(type, found[1])) == list(map(type, values))


@examples(100)
@given(
    vary=st.dictionaries(
        st.sampled_from(["a", "b.c", "d", "e"]),
        st.lists(st.integers(), min_size=1, max_size=5, unique=True),
        max_size=4,
    )
)
def test_a_grid_has_each_combination_once_the_last_key_fastest(vary: dict[str, list[int]]) -> None:
    points = grid(vary)
    assert [list(point) for point in points] == [list(vary)] * len(points)
    assert [tuple(point.values()) for point in points] == list(itertools.product(*vary.values()))


@examples(100)
@given(path=st.lists(st.text("abc_", min_size=1, max_size=3), min_size=1, max_size=4), value=VALUES)
def test_a_dotted_key_becomes_nested_mappings(path: list[str], value: Any) -> None:
    tree = nested(".".join(path), value)
    for key in path:
        assert list(tree) == [key]
        tree = tree[key]
    assert tree == value
