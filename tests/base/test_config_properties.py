"""Round trips: merged, assigned and TOML settings keep their values."""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import asdict
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from heliograph.base.config import from_mapping, merge
from heliograph.base.toml_text import parse_assignment, parse_toml, to_toml
from heliograph.link.settings import LinkSettings, load_settings

KEYS = st.sampled_from(["a", "b", "c_1", "distance_m"])
NUMBERS = st.integers(-(2**53), 2**53) | st.floats(allow_nan=False, allow_infinity=False)
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
LEAVES = st.booleans() | NUMBERS | TEXTS | st.lists(NUMBERS, max_size=4) | st.lists(TEXTS, max_size=3)
TREES = st.recursive(
    st.dictionaries(KEYS, LEAVES, max_size=4),
    lambda inner: st.dictionaries(KEYS, LEAVES | inner | st.lists(inner, min_size=1, max_size=3), max_size=4),
    max_leaves=12,
)


@examples(60)
@given(tree=TREES)
@pytest.mark.slow
def test_toml_and_back(tree: dict[str, Any]) -> None:
    assert parse_toml(to_toml(tree)) == tree


def test_changes_replace_values_and_keep_the_rest() -> None:
    base = {"a": 1, "b": {"c": 2, "d": {"e": 3}}, "f": [1, 2]}
    over = {"a": {}, "b": {"c": [5], "d": {}}, "f": 4, "g": {"h": 6}}
    before = deepcopy((base, over))
    merged = merge(base, over)
    assert merged == {"a": {}, "b": {"c": [5], "d": {"e": 3}}, "f": 4, "g": {"h": 6}}
    assert (base, over) == before
    assert merge(merged, over) == merged
    assert merge(base, {}) == merge({}, base) == base


@examples(40)
@given(
    items=st.lists(st.fixed_dictionaries({"a": st.integers(), "b": st.integers()}), min_size=1, max_size=4),
    changes=st.dictionaries(st.integers(0, 3), st.dictionaries(st.sampled_from("abc"), st.integers(), min_size=1)),
)
def test_a_mapping_laid_on_a_list_changes_items_by_number(
    items: list[dict[str, int]], changes: dict[int, dict[str, int]]
) -> None:
    changes = {k: change for k, change in changes.items() if k < len(items)}
    expected = [{**item, **changes.get(k, {})} for k, item in enumerate(items)]
    assert merge(items, {str(k): change for k, change in changes.items()}) == expected
    # index len(items) appends an item
    assert merge(items, {str(len(items)): {"a": 1}}) == [*items, {"a": 1}]


@examples(60)
@given(path=st.lists(KEYS, min_size=1, max_size=4), value=LEAVES)
@pytest.mark.slow
def test_an_assignment_and_back(path: list[str], value: Any) -> None:
    text = to_toml({"v": value}).removeprefix("v = ").rstrip("\n")
    tree = parse_assignment(f"{'.'.join(path)}={text}")
    for key in path:
        assert list(tree) == [key]
        tree = tree[key]
    assert tree == value
    assert type(tree) is type(value)


def optional(**values: st.SearchStrategy[Any]) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries({}, optional=values)


ARRAY = st.fixed_dictionaries({"x_m": st.floats(-3, 3), "start_s": st.floats(0, 0.1)})
SETTINGS = optional(
    signal=optional(side=st.sampled_from([4, 8, 16, 32]), data_pairs=st.integers(1, 200)),
    channel=optional(distance_m=st.floats(5, 300), arrays=st.lists(ARRAY, min_size=1, max_size=1)),
    receive=optional(receiver=st.sampled_from(["plain", "soft"]), detect=st.just({"candidates": 3})),
)


@examples(20)
@given(over=SETTINGS)
@pytest.mark.slow
def test_settings_of_the_link_and_back(over: dict[str, Any]) -> None:
    """By mapping, by TOML, and by an assignment for each value."""
    settings = load_settings("static", over)
    assert from_mapping(LinkSettings, asdict(settings)) == settings
    assert from_mapping(LinkSettings, parse_toml(to_toml(asdict(settings)))) == settings
    assert load_settings("static", None, assignments(over)) == settings


def assignments(tree: Any, path: str = "") -> list[str]:
    """Return assignments for all leaves; list items are addressed by number."""
    if isinstance(tree, list):
        tree = {str(k): item for k, item in enumerate(tree)}
    if not isinstance(tree, Mapping):
        return [f"{path}={tree}"]
    return [text for key, part in tree.items() for text in assignments(part, f"{path}.{key}" if path else key)]


@pytest.mark.parametrize("value", [1e22, -0.0, 5e-324, 2**53 + 1, True, "true", "1", "", " a ", "#", '"', "\\", "\x7f"])
def test_values_that_are_easily_mistaken(value: Any) -> None:
    back = parse_toml(to_toml({"v": value}))["v"]
    assert (back, type(back), str(back)) == (value, type(value), str(value))
