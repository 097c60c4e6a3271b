"""Link budgets over a grid of settings."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import astuple, replace
from functools import cache
from itertools import islice
from typing import Any

import numpy as np

from heliograph.base.config import merge
from heliograph.base.errors import SettingsError
from heliograph.cli import console, options
from heliograph.cli.options import option
from heliograph.experiments import flicker_metrics as metrics
from heliograph.experiments.flicker_metrics import Flicker
from heliograph.link.budget import Budget, Spot, budgets
from heliograph.link.photometry import LightSettings
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import transmitters
from heliograph.measure.bench import lasting, random_messages
from heliograph.signal import pwm
from heliograph.signal.formats import MODES, Format
from heliograph.sweeps.plan import grid, parse_vary_options, varied

DISTANCE = "channel.distance_m"


@options.command
def budget(
    *,
    vary: list[str] | None = options.vary_option("Repeat it for a grid. Default: distances from 25 m to 200 m."),
    settings: options.SettingsOptions = options.STATIC,
    candela: float | None = option(
        "Luminous intensity of an LED on its axis; default: value of channel.emitter.all_on.", "CD"
    ),
    f_number: float = option("Focal length over the lens's opening.", default=11.0),
    efficiency: float = option("Electrons a photon: transmission of the lens times quantum efficiency.", default=0.4),
    wavelength_nm: float = option("Wavelength of the LEDs.", "NM", "--wavelength", default=625.0),
    as_json: options.JsonList = False,
) -> None:
    """Calculate light, range and flicker of a planned link.

    Light, electrons, pixels, blur, range of each layer and flicker.

    Geometry, lens, sensor and LEDs are settings of 'channel'; see --set and --vary.
    """
    light = LightSettings(candela=candela, f_number=f_number, efficiency=efficiency, wavelength_nm=wavelength_nm)
    overlay, values = settings.overlay(), parse_vary_options(vary)
    if not values and "distance_m" not in overlay.get("channel", {}):
        values = {DISTANCE: [25, 40, 60, 80, 100, 125, 150, 200]}
    choices = grid(values)
    # at rest, the end of a drive does not limit distances
    overlay = merge(overlay, {"channel": {"speed_m_s": 0.0, "speed_profile": []}})
    links = [varied(settings.preset, overlay, choice) for choice in choices]
    rows, flickers = list[Budget](), []
    with console.progress("points", len(links)) as advance:
        for link, row in zip(links, budgets(links, light), strict=True):
            rows.append(row)
            flickers.append(_flicker(replace(link, channel=links[0].channel)))
            advance(len(rows))
    if as_json:
        points = []
        for choice, point, flicker in zip(choices, rows, flickers, strict=True):
            modes = {mode: {**array.plain(), "led_period_s": led_s} for mode, (array, led_s) in flicker.items()}
            points.append({"settings": choice, **point.plain(), "flicker": modes})
        console.say_json(points)
        return
    _show_spots(choices, [point.spot for point in rows])
    _show_ranges(choices, rows)
    intensities = ", ".join(dict.fromkeys(f"{point.candela:.3g} cd" for point in rows))
    console.say_prose(
        f"light: {intensities} an LED, f/{light.f_number:g}, {light.efficiency:g} electrons a photon, "
        f"{light.wavelength_nm:g} nm"
    )
    for text in dict.fromkeys(line for flicker in flickers for line in _flicker_lines(flicker)):
        console.say_prose(text)
    for text in _notes(rows):
        console.say_prose(f"note: {text}")


@cache
def _flicker(link: LinkSettings) -> dict[str, tuple[Flicker, float]]:
    """Measure the flicker of the array, and the longest period of an LED, in each mode of the link."""
    results: dict[str, tuple[Flicker, float]] = {}
    # a second of light, for a bandwidth of 1 Hz
    packets = max(1, math.ceil(1.0 / link.signal.packet_s))
    formats = link.transmit.formats
    # default formats: the paired mode, and the single mode as an alternative; the short mode has the light of the
    # paired mode
    sent = {"paired": formats, "single": (Format(mode="single"),)}
    if formats:
        sent = {mode: tuple(form for form in formats if form.mode == mode) for mode in MODES}
        sent = {mode: forms for mode, forms in sent.items() if forms}
    for mode, forms in sent.items():
        changed = replace(link, transmit=replace(link.transmit, formats=forms))
        try:
            messages = random_messages(lasting(changed, packets * link.signal.packet_s), 0)
            sender = transmitters(changed, messages)[0]
        except SettingsError:
            if formats or mode == "paired":
                raise
            continue  # the signal does not support the single mode
        slots = np.concatenate(
            [pwm.lit_slots(levels, link.signal.slot_order) for levels in islice(sender.packets(), packets)]
        )
        slots, slot_s = slots.reshape(-1, *slots.shape[2:]), link.signal.pattern_period_s / pwm.SLOTS
        # LEDs on the diagonal of the array
        leds = (slots[:, k, k] for k in range(min(16, link.signal.side)))
        led_s = max(metrics.flickering_period(flux, slot_s) for flux in leds)
        results[mode] = metrics.measure(slots.mean((1, 2)), slot_s), led_s
    return results


def _show_spots(choices: Sequence[Mapping[str, Any]], spots: Sequence[Spot]) -> None:
    """Print a row for each point: the image of the array."""
    names = "m", "px/LED", "px/side", "e-/LED", "e-/px", "light", "peak", "noise", "blur px", "blur/pitch", "e-/bit"
    head = [*choices[0], *names]
    rows = [
        [*map(str, choice.values()), *(f"{number:.3g}" for number in astuple(spot)[:-1])]
        for choice, spot in zip(choices, spots, strict=True)
    ]
    console.say_table(head, rows)


def _show_ranges(choices: Sequence[Mapping[str, Any]], budgets: Sequence[Budget]) -> None:
    """Print a row for each layer of each receiver and mode; the distance has no influence on the range."""
    rows: dict[tuple[str, ...], None] = {}
    for choice, budget in zip(choices, budgets, strict=True):
        values = [str(value) for key, value in choice.items() if key != DISTANCE]
        for layer in budget.layers:
            limit_m = budget.found_m[layer.receiver]
            ranges = (f"{m:.0f} m" + ("*" if m >= limit_m else "") for m in (layer.range_m, layer.most_m))
            rows[(*values, layer.receiver, layer.mode, layer.layer, f"{layer.rate:.3g}", *ranges)] = None
    if rows:
        keys = [key for key in choices[0] if key != DISTANCE]
        console.say("")
        console.say_table([*keys, "receiver", "mode", "layer", "rate", "reads to", "at most"], [*map(list, rows)])
        console.say("*: limit of the search")
    console.say("")


def _notes(budgets: Sequence[Budget]) -> list[str]:
    """Return the notes of all points; of notes with different numbers the first."""
    groups: dict[str, dict[str, None]] = {}
    for note in (note for budget in budgets for note in budget.notes):
        groups.setdefault(re.sub(r"[-+]?\d[\d.e+-]*", "", note), {})[note] = None
    return [
        next(iter(notes)) + (f" (similar at {len(notes) - 1} more)" if len(notes) > 1 else "")
        for notes in groups.values()
    ]


def _flicker_lines(flicker: Mapping[str, tuple[Flicker, float]]) -> list[str]:
    return [
        f"flicker, {mode}: the light of the array is even over {_period_text(array.period_s)}, of an LED over "
        f"{_period_text(led_s)} (IEEE 802.15.7: 5 ms or less); {array.slow_percent:.2f} % at most below 90 Hz, "
        f"{array.limit_share:.2f} of IEEE 1789's low-risk limit at {array.limit_hz:.0f} Hz; SVM {array.svm:.2f} "
        f"(EU: 0.4)"
        for mode, (array, led_s) in flicker.items()
    ]


def _period_text(period_s: float) -> str:
    return f"{period_s * 1e3:.3g} ms ({1 / period_s:.3g} Hz)" if period_s else "any time"
