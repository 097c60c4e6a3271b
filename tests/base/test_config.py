"""Settings from mappings, TOML and assignments, with one-line errors for invalid input."""

import dataclasses
import re
import tomllib
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import asdict
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG, from_mapping, keys_of, merge
from heliograph.base.errors import SettingsError
from heliograph.base.toml_text import parse_assignment, parse_toml, to_toml
from heliograph.link.settings import PRESETS, LinkSettings, load_settings


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Item:
    x_m: float = 0.0
    name: str = "a"


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Tree:
    count: int = 3
    duration_s: float | None = None
    shares: tuple[float, ...] = (0.5,)
    item: Item = Item()
    items: tuple[Item, ...] = (Item(),)


def test_a_mapping_becomes_settings_and_comes_back() -> None:
    tree = from_mapping(Tree, {"count": 4, "item": {"x_m": 2}, "items": [{"name": "b"}, {}]})
    assert tree == Tree(count=4, item=Item(x_m=2.0), items=(Item(name="b"), Item()))
    assert from_mapping(Tree, asdict(tree)) == tree


@pytest.mark.parametrize(("mapping", "parts"), [
    ({"coutn": 1}, ["unknown setting 'coutn'; did you mean 'count'"]),
    ({"item": {"x": 1}}, ["unknown setting 'item.x'; did you mean 'item.x_m'"]),
    ({"nmae": "c"}, ["unknown setting 'nmae'; did you mean", "name"]),
    ({"items": [{}, {"x_n": 1}]}, ["unknown setting 'items.1.x_n'; did you mean 'items.1.x_m'"]),
    ({"zzzz": 1}, ["unknown setting 'zzzz'; known are count, duration_s, item, items, shares"]),
    ({"count": "many"}, ["'count'", "integer", "'many'"]), ({"count": 2.5}, ["'count'", "integer", "2.5"]),
    ({"item": 3}, ["'item'", "3"]), ({"item": {"x_m": float("nan")}}, ["'item.x_m'", "finite", "nan"]),
    ({"item": {"x_m": float("inf")}}, ["'item.x_m'", "finite"]),
    ({"shares": [0.1, "half"]}, ["'shares.1'", "number", "'half'"]), ({"items": 3}, ["'items'", "tuple", "3"]),
    *[(other, ["Tree"]) for other in (None, 5, [1], "text")],
])  # fmt: skip
def test_invalid_mapping_is_one_line_with_key_rule_and_value(mapping: Any, parts: list[str]) -> None:
    with pytest.raises(SettingsError, match=".*".join(map(re.escape, parts))):
        from_mapping(Tree, mapping)


@pytest.mark.parametrize(("change", "parts"), [
    ("channel.distance_m=-1", ["channel.distance_m", "greater than or equal to 0.1", "-1"]),
    ("channel.sensor.bits=13", ["channel.sensor.bits", "12", "13"]),
    ("signal.side=7", ["signal.side", "multiple of 4", "7"]),
    ("channel.camera.exposure_s=0.002", ["exposure_s", "0.001", "0.002"]),
    ("receive.detect.min_side_px=600", ["min_side_px", "max_side_px", "600"]),
    ("transmit.identities=[30]", ["transmit.identities.0", "30"]), ("channel.stop_m=90", ["stop_m", "80", "90"]),
    ("channel.arrays.0.hidden=[0,0,5,5]", ["setting 'channel.arrays.0.hidden"]),
    *[(text, ["write key=value"]) for text in ("", "a", "a.b", "=3", "a.=3", ".a=3", "a..b=3")],
])  # fmt: skip
def test_invalid_assignment_is_one_line_with_key_and_range(change: str, parts: list[str]) -> None:
    with pytest.raises(SettingsError) as caught:
        load_settings(assignments=[change])
    assert [part for part in parts if part not in str(caught.value)] == []


@pytest.mark.parametrize(("text", "value"), [
    ("3", 3), (" 2.5", 2.5), ("true", True), ("[1, 2]", [1, 2]), ("'plain'", "plain"), ("plain", "plain"),
    ("1/3", "1/3"), ("{x = 1}", {"x": 1}), ("", ""), ("1\nother = 2", "1\nother = 2"),
])  # fmt: skip
def test_the_value_of_an_assignment_is_toml_or_bare_text(text: str, value: Any) -> None:
    assert parse_assignment(f"a.b={text}") == {"a": {"b": value}}


@pytest.mark.parametrize("wrong", ["2", "-1", "x", ""])
def test_numbers_of_missing_list_items_are_refused(wrong: str) -> None:
    with pytest.raises(SettingsError, match="not an item of a list of 1"):
        merge(({"x": 0, "y": 1},), {wrong: {"x": 5}})


def test_toml_errors_are_settings_errors() -> None:
    with pytest.raises(SettingsError, match=r"not valid TOML.*line 2"):
        parse_toml("a = 1\nb = = 2\n")


def test_later_assignments_win() -> None:
    changes = ["channel.arrays.0.x_m=2", "channel.distance_m=50", "channel.arrays.0.x_m=3"]
    channel = load_settings(over={"channel": {"distance_m": 60.0}}, assignments=changes).channel
    assert (channel.distance_m, channel.arrays[0].x_m, channel.arrays[0].y_m) == (50, 3, -1.0)


def test_keys_are_leaves_by_dots() -> None:
    assert ",".join(keys_of(Tree)) == "count,duration_s,shares,item.x_m,item.name,items.0.x_m,items.0.name"
    known = set(keys_of(LinkSettings))
    assert {"signal.rate.low", "channel.camera.fps", "channel.arrays.0.x_m", "receive.decode.iterations"} <= known


@pytest.mark.parametrize("name", PRESETS)
def test_toml_of_every_preset_reads_back_the_same(name: str) -> None:
    settings = load_settings(name)
    text = to_toml(asdict(settings))
    assert text.startswith("[signal]\n")
    assert from_mapping(LinkSettings, tomllib.loads(text)) == settings


def test_toml_omits_none() -> None:
    text = to_toml({"a": None, "b": 1, "i": [{"a": 1, "s": {"b": None}}, {"a": 3}]})
    assert tomllib.loads(text) == {"b": 1, "i": [{"a": 1, "s": {}}, {"a": 3}]}


def test_a_plain_dataclass_refuses_keys_that_it_lacks() -> None:
    @dataclasses.dataclass(frozen=True)
    class Plain:
        patience: float = 0.5

    assert from_mapping(Plain, {"patience": 2}).patience == 2
    with pytest.raises(SettingsError, match="unknown setting 'patiance'; did you mean 'patience'"):
        from_mapping(Plain, {"patiance": 2})


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
    assert merged == merge(merged, over) == {"a": {}, "b": {"c": [5], "d": {"e": 3}}, "f": 4, "g": {"h": 6}}
    assert (base, over) == before
    assert merge(base, {}) == merge({}, base) == base


@examples(40)
@given(
    items=st.lists(st.fixed_dictionaries({"a": st.integers(), "b": st.integers()}), min_size=1, max_size=4),
    changes=st.dictionaries(st.integers(0, 3), st.dictionaries(st.sampled_from("abc"), st.integers(), min_size=1)),
)
def test_a_mapping_laid_on_a_list_changes_items_by_number(items: Any, changes: dict[int, dict[str, int]]) -> None:
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
    assert (tree, type(tree)) == (value, type(value))


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
