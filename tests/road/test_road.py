"""SPATEM and MAPEM: encoding, decoding, countdown, damaged messages."""

import random
import sys
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from heliograph.base.config import from_mapping
from heliograph.base.errors import SettingsError
from heliograph.road import codec
from heliograph.road.codec import mapem, road_values, road_words, spatem, updates
from heliograph.road.countdown import Countdown
from heliograph.road.junction import Junction, example

pytest.importorskip("pycrate_asn1dir", reason="needs the extra its: pip install 'heliograph[its]'")

JUNCTION = from_mapping(Junction, example())
EXAMPLE = Path(__file__).parents[2] / "examples" / "junction.toml"


def values_of(data: bytes) -> Mapping[str, Any]:
    values = road_values(data)
    assert values is not None
    return values


def lights(data: bytes) -> list[tuple[int, str, float | None]]:
    return [(g["group"], g["phase"], g["left_s"]) for one in values_of(data)["junctions"] for g in one["groups"]]


def test_a_spatem_of_one_light_has_27_bytes() -> None:
    plain = {"id": 7, "station": 7, "groups": [{"group": 1, "phases": [{"phase": "red", "seconds": 20}]}]}
    junction = from_mapping(Junction, plain)
    assert len(spatem(junction, 0.0)) == 34  # includes the next phase
    values = values_of(bytes.fromhex("01040000000700180003810000003e875300000104340269026900"))
    light = {"group": 1, "phase": "red", "end_s": 123.4, "left_s": 1293.4, "then": []}
    assert values["junctions"] == [{"id": 7, "stamp_s": 2430.0, "groups": [light]}]


def test_lights_and_lanes_survive_the_encoding() -> None:
    assert lights(spatem(JUNCTION, 3.0)) == [(1, "red", 9.0), (2, "green", 6.0)]
    assert lights(spatem(JUNCTION, 12.5)) == [(1, "red-yellow", 1.5), (2, "red", 20.5)]
    assert lights(spatem(JUNCTION, 36.0)) == [(1, "red", 11.0), (2, "green", 8.0)]  # the 35 s cycle restarts
    map_ = values_of(mapem(JUNCTION))
    (one,) = map_["junctions"]
    assert (one["id"], one["name"], one["lane_width_m"]) == (7, "Harbour Road", 3.25)
    assert (one["latitude"], one["longitude"], len(one["lanes"])) == (pytest.approx(35.155), pytest.approx(136.966), 9)
    assert one["lanes"][0] == {
        "lane": 1, "kind": "vehicle", "towards": True, "away": False, "points_m": [(1.7, -10.0), (1.7, -60.0)],
        "groups": [1], "to": [4],
    }  # fmt: skip
    assert road_words(map_) == "MAPEM of junction 7 (Harbour Road): 9 lanes"


def test_the_example_file_equals_the_example() -> None:
    assert from_mapping(Junction, tomllib.loads(EXAMPLE.read_text())) == JUNCTION


def test_points_at_all_distances_are_exact_to_a_centimetre() -> None:
    rng = random.Random(4)
    for far in (2, 8, 18, 38, 78, 300):
        points = tuple((round(rng.uniform(-far, far), 2) / 2, round(rng.uniform(-far, far), 2) / 2) for _ in range(9))
        lane = replace(JUNCTION.lanes[1], points_m=points)
        values = values_of(mapem(replace(JUNCTION, lanes=(JUNCTION.lanes[1], replace(lane, lane=3)))))
        for (x, y), (east, north) in zip(values["junctions"][0]["lanes"][1]["points_m"], points, strict=True):
            assert (x, y) == (pytest.approx(east, abs=0.0051), pytest.approx(north, abs=0.0051))


def test_the_countdown_continues_between_messages_and_into_the_next_phase() -> None:
    """The camera clock has an arbitrary origin, packets arrive late or get lost, and the hour rolls over."""
    junction = replace(JUNCTION, begins=JUNCTION.begins.replace(minute=59, second=50))
    sent, down, ahead = updates(junction, 20.0), Countdown(), 1234.5
    assert len(sent) == 20
    for packet in range(2, 200):
        time_s = packet * 0.1
        if packet % 3 == 0 or 60 < packet < 90:
            continue
        stamped = [data for start, data in sent if start <= time_s + 1e-9][-1]
        down.take(values_of(stamped), time_s + ahead)
        if packet > 20:
            (one,) = down.at(time_s + ahead)
            group = one["groups"][0]
            ((phase, end_s),) = junction.groups[0].following(time_s, 1)
            if min(abs(time_s - end) for end in (12.0, 14.0)) > 0.3:
                assert (group["phase"], group["left_s"]) == (phase, pytest.approx(end_s - time_s, abs=0.21))
    assert down.at(ahead + 31.0) == []


@pytest.mark.parametrize(("change", "word"), [
    ({"groups": []}, "groups"), ({"id": 70000}, "id"), ({"name": "Stra\u00dfe"}, "name"),
    ({"groups": [{"group": 1, "phases": [{"phase": "blue", "seconds": 1}]}]}, "phase"),
    ({"lanes": [{"lane": 1, "points_m": [[0, 0], [1, 1]], "group": 9, "to": [1]}]}, "group 9"),
    ({"lanes": [{"lane": 1, "points_m": [[0, 0], [1, 1]], "to": [4]}]}, "lane 4"),
])  # fmt: skip
def test_a_wrong_junction_raises_a_message_of_one_line(change: dict[str, Any], word: str) -> None:
    with pytest.raises(SettingsError, match=word) as raised:
        from_mapping(Junction, {**example(), **change})
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("data", [b"", b"\x01", b"brake", bytes(40), b"\x01\x02" + bytes(40), b"\x03\x04" + bytes(40)])
def test_other_messages_have_no_road_values(data: bytes) -> None:
    assert road_values(data) is None


@pytest.mark.slow
def test_damaged_messages_give_a_line_of_text() -> None:
    """Try 800 truncated, bit-flipped and random messages; the result is always valid text."""
    rng, seen, whole = random.Random(6), set(), [spatem(JUNCTION, 1.0), mapem(JUNCTION)]
    for _ in range(800):
        data = bytearray(rng.choice(whole))
        for _ in range(rng.randrange(4)):
            data[rng.randrange(6, len(data))] ^= 1 << rng.randrange(8)
        if rng.random() < 0.3:
            del data[rng.randrange(6, len(data)) :]
        if rng.random() < 0.3:
            data[6:] = rng.randbytes(rng.randrange(60))
        values = road_values(bytes(data))
        seen.add(values is not None and "reason" in values)
        if values is not None:
            words = road_words(values)
            assert "\n" not in words
            assert len(words) < 6000
            Countdown().take(values, 1.0)
    assert seen == {True, False}
    assert "more than 8192" in values_of(whole[0] + bytes(9000))["reason"]


def test_a_message_has_a_kind_without_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    data = spatem(JUNCTION, 0.0)
    codec._types.cache_clear()
    monkeypatch.setitem(sys.modules, "pycrate_asn1dir", None)
    values = values_of(data)
    codec._types.cache_clear()
    assert values["kind"] == "SPATEM"
    assert "heliograph[its]" in road_words(values)
