"""Bounds of linear receivers by the true channel of a simulation, which no other receiver gets."""

from dataclasses import fields
from functools import cache
from typing import Any

import pytest
from scenes import film, link, received

from heliograph import make_receiver
from heliograph.base.errors import SettingsError
from heliograph.benchmarks.benchmark import plan_benchmark
from heliograph.benchmarks.figure import draw
from heliograph.channel.truth import KnownChannel, Truth
from heliograph.measure.bench import run_block
from heliograph.measure.counts import BlockCounts, LayerCounts
from heliograph.receive.registry import RECEIVERS, ReceiverPart
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import LAYERS, SignalSettings

GENIES = ["genie-zero-forcing", "genie-mmse"]


@cache
def counts(receiver: str, distance_m: float, *changes: str) -> BlockCounts:
    settings = link(f"receive.receiver={receiver}", "signal.data_pairs=24", *changes, distance_m=distance_m)
    found = run_block(settings, 4502, max_packets=3)
    assert found.packets == 3
    return found


def raw_errors(receiver: str, distance_m: float, *changes: str) -> int:
    """Count the wrong bits before the channel decoder, of 18432; all of a missed packet."""
    layers = counts(receiver, distance_m, *changes).layers.values()
    return sum(layer.raw_errors for layer in layers) + 3 * 24 * 256 - sum(layer.raw_bits for layer in layers)


@pytest.mark.parametrize(("blind", "genie", "distance_m", "changes"), [
    ("zero-forcing", "genie-zero-forcing", 64.0, ("signal.modulation=ook",)),
    ("mmse", "genie-mmse", 62.0, ("signal.modulation=ook", "channel.arrays.0.spread=0.4")),
])  # fmt: skip
def test_a_known_channel_reads_more_bits(blind: str, genie: str, distance_m: float, changes: tuple[str, ...]) -> None:
    assert 0 < raw_errors(genie, distance_m, *changes) < 0.9 * raw_errors(blind, distance_m, *changes)


def test_a_genie_reads_an_array_too_small_for_the_search() -> None:
    assert counts("mmse", 150.0).detected == 0
    genie = counts("genie-mmse", 150.0)
    assert genie.detected == 3
    assert genie.layers["high"].raw_errors < 0.3 * genie.layers["high"].raw_bits
    assert genie.false_codewords == 0


@pytest.mark.parametrize("name", GENIES)
def test_a_film_without_truth_is_refused_in_one_line(name: str) -> None:
    settings = link(f"receive.receiver={name}")
    with pytest.raises(SettingsError, match=f"{name} needs the true channel .* 'heliograph benchmark --rec") as error:
        received(film(settings, 2, roi_margin_px=12), settings)
    assert "\n" not in str(error.value)


def test_a_genie_refuses_a_channel_that_it_does_not_know() -> None:
    with pytest.raises(SettingsError, match="leave out the settings"):
        run_block(link("receive.receiver=genie-mmse", "channel.sensor.gamma=2.2"), 1, max_packets=1)


def test_the_default_of_the_benchmark_has_no_bounds_and_the_figure_marks_them() -> None:
    names = [tally.point.choice["receiver"] for tally in plan_benchmark(["static-60"], None, 0, 1)]
    assert {"plain", "mmse", "soft"} <= set(names)
    assert not set(names) & set(GENIES)
    tallies = plan_benchmark(["static-60"], ["mmse", *GENIES], 0, 1)
    for tally in tallies:
        counts = LayerCounts.of_missed(1)
        tally.add(0, BlockCounts(layers=dict.fromkeys(LAYERS, counts)), seconds=1.0)
    figure = draw(tallies)
    labels = figure.axes[0].get_legend_handles_labels()[1]
    assert labels == ["mmse", "genie-zero-forcing (bound)", "genie-mmse (bound)"]


def test_no_other_receiver_gets_the_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    """Offer the truth to recorders in place of all receivers."""
    needs = {name: getattr(RECEIVERS[name], "needs_truth", False) for name in RECEIVERS.built_in}
    assert [name for name, needed in needs.items() if needed] == GENIES
    given: dict[str, tuple[Any, ...]] = {}

    def part(name: str) -> ReceiverPart:
        def make(*arguments: Any) -> None:
            given[name] = arguments

        # a receiver of another package asks in vain
        return ReceiverPart(make, needs_truth=needs.get(name, True))

    RECEIVERS.register("asking", None, print)
    monkeypatch.setattr(type(RECEIVERS), "__getitem__", lambda _, name: part(name))
    truth = object()
    for name in [*needs, "asking"]:
        make_receiver(SignalSettings(), ReceiveSettings(receiver=name), None, truth)
        assert [argument is truth for argument in given[name]] == [False] * 3 + [True] * (name in GENIES), name


def test_the_truth_has_no_data() -> None:
    assert {field.name for field in fields(KnownChannel)} == {"settings", "identities", "latest"}
    assert {field.name for field in fields(Truth)} == {"index", "time_s", "arrays", "noise", "faults"}
