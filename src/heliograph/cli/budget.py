"""heliograph budget."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from heliograph.base.config import merge
from heliograph.cli import console, options

if TYPE_CHECKING:
    from heliograph.experiments.flicker.metrics import Flicker
    from heliograph.link.budget import Budget, Spot
    from heliograph.link.settings import LinkSettings

DISTANCE = "channel.distance_m"

DISTANCES_M = (25, 40, 60, 80, 100, 125, 150, 200)
"""Distances of the table where nothing else is asked for."""

AT_REST = {"channel": {"speed_m_s": 0.0, "speed_profile": []}}
"""What a budget is of, whatever the preset: then the end of a drive does not bound distances."""

NUMBER = re.compile(r"[-+]?\d[\d.e+-]*")
"""A number within a note."""


def run_budget(
    vary: list[str] | None,
    preset: str,
    file: Path | None,
    assignments: list[str] | None,
    light: Mapping[str, Any],
    as_json: bool,
) -> None:
    """Print what a link has before it is built, over a grid of settings."""
    from heliograph.link.budget import Budgets
    from heliograph.link.photometry import LightSettings
    from heliograph.sweeps.plan import grid, varied

    made = Budgets(LightSettings(**light))
    over, given = options.laid_over(file, assignments), options.varied(vary)
    if not given and DISTANCE.partition(".")[2] not in over.get("channel", {}):
        given = {DISTANCE: list(DISTANCES_M)}
    choices = grid(given)
    over = merge(over, AT_REST)
    links = [varied(preset, over, choice) for choice in choices]
    budgets, flickers = [], []
    with console.progress("points", len(links)) as advance:
        for number, link in enumerate(links, 1):
            budgets.append(made.of(link))
            flickers.append(_flicker(replace(link, channel=links[0].channel)))
            advance(number)
    if as_json:
        console.say_json(
            [
                {
                    "settings": choice,
                    **budget.plain(),
                    "flicker": {mode: {**one.plain(), "led_period_s": led_s} for mode, (one, led_s) in flicker.items()},
                }
                for choice, budget, flicker in zip(choices, budgets, flickers, strict=True)
            ]
        )
        return
    _say_spots(choices, [budget.spot for budget in budgets])
    _say_reach(choices, budgets)
    _say_light(budgets, made)
    for text in dict.fromkeys(line for flicker in flickers for line in _flicker_lines(flicker)):
        console.say_prose(text)
    for text in _notes(budgets):
        console.say_prose(f"note: {text}")


@cache
def _flicker(link: "LinkSettings") -> "dict[str, tuple[Flicker, float]]":
    """Flicker of the array's light in each mode that is sent, or could be, and the longest period of an LED alone."""
    import numpy as np

    from heliograph.base.errors import SettingsError
    from heliograph.experiments.flicker import metrics
    from heliograph.link.simulate import transmitters
    from heliograph.measure.bench import lasting, random_messages
    from heliograph.signal import pwm
    from heliograph.signal.formats import MODES, Format

    found: dict[str, tuple[Flicker, float]] = {}
    # time of light whose flicker is measured, rounded up to whole packets; 1 Hz of bandwidth
    packets = max(1, math.ceil(1.0 / link.signal.packet_s))
    formats = link.transmit.formats
    # the short mode has the light of the paired one
    for mode in MODES if formats else ("paired", "single"):
        named = tuple(one for one in formats if one.mode == mode) if formats else (Format(mode=mode),)
        if formats and not named:
            continue
        sent = () if mode == "paired" and not formats else named
        one = replace(link, transmit=replace(link.transmit, formats=sent))
        try:
            sender = transmitters(one, random_messages(lasting(one, packets * link.signal.packet_s), 0))[0]
        except SettingsError:
            if formats or mode == "paired":
                raise
            continue  # this signal has no single mode
        slots = np.concatenate(
            [pwm.lit_slots(levels, link.signal.slot_order) for levels in islice(sender.packets(), packets)]
        )
        slots, slot_s = slots.reshape(-1, *slots.shape[2:]), link.signal.pattern_period_s / pwm.SLOTS
        # LEDs whose own flicker is measured, along the array's diagonal
        alone = (slots[:, k, k] for k in range(min(16, link.signal.side)))
        led_s = max(metrics.flickering_period(flux, slot_s) for flux in alone)
        found[mode] = metrics.measure(slots.mean((1, 2)), slot_s), led_s
    return found


def _say_spots(choices: Sequence[Mapping[str, Any]], spots: "Sequence[Spot]") -> None:
    """A line for each point: the array as the camera sees it."""
    head = [*choices[0], "m", "px/LED", "px/side", "e-/LED", "e-/px", "light", "peak", "noise", "blur px", "blur/pitch"]
    rows = []
    for choice, spot in zip(choices, spots, strict=True):
        numbers = (spot.distance_m, spot.pitch_px, spot.side_px, spot.electrons_led, spot.electrons_px, spot.light,
                   spot.peak, spot.noise, spot.blur_px, spot.blur_pitches)  # fmt: skip
        rows.append([*map(str, choice.values()), *(f"{number:.3g}" for number in numbers)])
    console.say_table(head, rows)


def _say_reach(choices: Sequence[Mapping[str, Any]], budgets: "Sequence[Budget]") -> None:
    """A line for each layer of each receiver and mode; the distance makes no difference to it."""
    rows: dict[tuple[str, ...], None] = {}
    for choice, budget in zip(choices, budgets, strict=True):
        others = [str(value) for key, value in choice.items() if key != DISTANCE]
        for layer in budget.layers:
            found = budget.found_m[layer.receiver]
            reach, most = (f"{m:.0f} m" + ("*" if m >= found else "") for m in (layer.range_m, layer.most_m))
            rows[(*others, layer.receiver, layer.mode, layer.layer, f"{layer.rate:.3g}", reach, most)] = None
    if rows:
        keys = [key for key in choices[0] if key != DISTANCE]
        console.say("")
        console.say_table([*keys, "receiver", "mode", "layer", "rate", "reads to", "at most"], [*map(list, rows)])
        console.say("*: limit of the search")
    console.say("")


def _say_light(budgets: "Sequence[Budget]", made: Any) -> None:
    light = made.light
    lit = dict.fromkeys(f"{budget.candela:.3g} cd" for budget in budgets)
    console.say_prose(
        f"light: {', '.join(lit)} an LED, f/{light.f_number:g}, {light.efficiency:g} electrons a photon, "
        f"{light.wavelength_nm:g} nm"
    )


def _notes(budgets: "Sequence[Budget]") -> list[str]:
    """Notes of all points; of those that differ by numbers alone, as by the distance, the first."""
    alike: dict[str, dict[str, None]] = {}
    for note in (note for budget in budgets for note in budget.notes):
        alike.setdefault(NUMBER.sub("", note), {})[note] = None
    return [
        next(iter(notes)) + (f" (and alike at {len(notes) - 1} more)" if len(notes) > 1 else "")
        for notes in alike.values()
    ]


def _flicker_lines(flicker: "Mapping[str, tuple[Flicker, float]]") -> list[str]:
    return [
        f"flicker, {mode}: the array's light is even over {_period(one.period_s)}, an LED's over {_period(led_s)} "
        f"(IEEE 802.15.7: 5 ms or less); {one.slow_percent:.2f} % at most below 90 Hz, {one.limit_share:.2f} of IEEE "
        f"1789's low-risk limit at {one.limit_hz:.0f} Hz; SVM {one.svm:.2f} (EU: 0.4)"
        for mode, (one, led_s) in flicker.items()
    ]


def _period(period_s: float) -> str:
    return f"{period_s * 1e3:.3g} ms ({1 / period_s:.3g} Hz)" if period_s else "any time"
