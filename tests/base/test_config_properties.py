"""Round trips: merged, assigned and TOML settings keep their values."""

from collections.abc import Iterator, Mapping
from copy import deepcopy
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from heliograph.base.config import from_mapping, merge, to_mapping
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


def leaves(tree: Mapping[str, Any], path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield path and value of each leaf; an empty mapping counts as a leaf."""
    for key, value in tree.items():
        if isinstance(value, Mapping) and value:
            yield from leaves(value, (*path, key))
        else:
            yield (*path, key), value


def at(tree: Any, path: tuple[str, ...]) -> Any:
    """Return the value at a path, or None if the path does not exist."""
    for key in path:
        tree = tree.get(key) if isinstance(tree, Mapping) else None
    return tree


NESTED = st.recursive(LEAVES, lambda inner: st.dictionaries(KEYS, inner, max_size=4), max_leaves=12)
MAPPINGS = st.dictionaries(KEYS, NESTED, max_size=4)
"""Trees without lists; merging a mapping into a list changes list items by number."""


@examples(200)
@given(tree=TREES)
@pytest.mark.slow
def test_toml_and_back(tree: dict[str, Any]) -> None:
    assert parse_toml(to_toml(tree)) == tree


@examples(150)
@given(base=MAPPINGS, over=MAPPINGS)
@pytest.mark.slow
def test_what_is_laid_over_stands_and_the_rest_stays(base: dict[str, Any], over: dict[str, Any]) -> None:
    # exclude lists: a mapping merged into a list changes list items
    base = {k: v for k, v in base.items() if not any(isinstance(value, list) for _, value in leaves({k: v}))}
    before = deepcopy((base, over))
    merged = merge(base, over)
    assert (base, over) == before
    for path, value in leaves(over):
        under = at(base, path)
        # merging an empty mapping keeps an existing mapping
        assert at(merged, path) == (under if value == {} and isinstance(under, Mapping) else value)
    for path, value in leaves(base):
        above = [at(over, path[: k + 1]) for k in range(len(path))]
        if above[-1] is None and all(one is None or isinstance(one, Mapping) for one in above):
            assert at(merged, path) == value
    assert merge(merged, over) == merged
    assert merge(base, {}) == merge({}, base) == merge(base, base) == base


@examples(100)
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


@examples(200)
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


@examples(100)
@given(text=TEXTS.filter(lambda t: t.strip() == t and "\n" not in t and "\r" not in t))
def test_what_is_no_toml_is_bare_text(text: str) -> None:
    found = parse_assignment(f"key=a {text}")["key"]
    assert found == f"a {text}".strip()


SETTINGS = st.fixed_dictionaries(
    {},
    optional={
        "signal": st.fixed_dictionaries(
            {}, optional={"side": st.sampled_from([4, 8, 16, 32]), "data_pairs": st.integers(1, 200)}
        ),
        "channel": st.fixed_dictionaries(
            {},
            optional={
                "distance_m": st.floats(5, 300),
                "arrays": st.lists(
                    st.fixed_dictionaries({"x_m": st.floats(-3, 3), "start_s": st.floats(0, 0.1)}),
                    min_size=1,
                    max_size=1,
                ),
            },
        ),
        "receive": st.fixed_dictionaries(
            {}, optional={"receiver": st.sampled_from(["plain", "soft"]), "detect": st.just({"candidates": 3})}
        ),
    },
)


@examples(60)
@given(over=SETTINGS)
@pytest.mark.slow
def test_settings_of_the_link_and_back(over: dict[str, Any]) -> None:
    """By mapping, by TOML, and by an assignment for each value."""
    settings = load_settings("static", over)
    assert from_mapping(LinkSettings, to_mapping(settings)) == settings
    assert from_mapping(LinkSettings, parse_toml(to_toml(to_mapping(settings)))) == settings
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
