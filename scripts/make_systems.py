"""Make docs/published-systems.md and its figure: `python scripts/make_systems.py`."""

import csv
from functools import cache
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from heliograph.experiments.plots import BLUE, GRAY, GREEN, ORANGE, RED, figure_svg, legend_below, styled
from heliograph.link.budget import RangeEstimator, budget
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.measure.bench import run_block
from heliograph.measure.counts import BlockCounts
from heliograph.signal.formats import AGREED, Mode
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import LAYERS, MULTIPLICITY

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
Row = dict[str, str]
ASSUMED = "Nagura et al."  # light of the reference link
PACKETS = 6  # single packets without inverses at each distance

HEAD = """# Published systems

Published systems compared with the simulated receiver "soft" in the reference link. `read` states whether the
numbers come from a paper's text, its abstract, or a citation. Empty cells are not stated there.
`scripts/make_systems.py` makes this page from [published-systems.csv](published-systems.csv).

![Bit rate by distance and by photoelectrons per information bit](pictures/published-systems.svg)

## Photoelectrons per information bit

The electrons that the light of the array frees in the sensor, over the information bits that arrive:

    e = n^2 E_led(Z) P / (2 k)

with n^2 LEDs, E_led electrons per exposure of a lit LED (`heliograph budget`, column `e-/LED`), P frames per
packet, half of the LEDs lit on average, and k information bits of the codewords that arrive. `heliograph budget`
prints the value for k of all codewords as `e-/bit`.

The bound has the mutual information of each symbol with all others, pose and blur known
([budget](budget.md#range)), summed over the symbols, in place of k: independent symbols d_i have
I(d; r) = sum_i I(d_i; r | d_1..d_i-1) <= sum_i I(d_i; r | all others).

**No camera system read states the light at the lens**: intensity, f-number, exposure and efficiency together.
The value of Nagura et al. (hollow) is derived with the light of the reference link, 16 kbit/s and 80 m. Photon counters
state photons per bit, SPAD array and Dacha et al. detected ones. All others are marked with a dash.

"""


def read(path: Path) -> list[Row]:
    """Read a table."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


SINGLE = {"mode": "single", "high": 0.9, "middle": 0.9, "low": 0.9}
NAMES: dict[Mode, str] = {"paired": "pairs", "single": "without inverses"}
COLOURS: dict[Mode, str] = {"paired": BLUE, "single": ORANGE}


def link(distance_m: float, mode: Mode = "paired") -> LinkSettings:
    """Reference link at rest: pairs at code rate 1/3, or single patterns at 9/10."""
    formats = [SINGLE] if mode == "single" else []
    changes = {"channel": {"distance_m": distance_m}, "transmit": {"formats": formats}}
    return load_settings("static", {**changes, "receive": {"receiver": "soft"}})


@cache
def electrons_per_second(distance_m: float) -> float:
    """Photoelectrons of the array per second: half of the LEDs are lit."""
    # the light of an LED is that of a small array, whose ranges take less time
    small = {"signal": {"side": 4, "data_pairs": 192}, "channel": {"distance_m": distance_m}}
    settings = link(distance_m)
    electrons_led = budget(load_settings("static", small)).spot.electrons_led
    return settings.signal.side**2 * electrons_led * settings.channel.camera.fps / 2


def bits_of(settings: LinkSettings) -> dict[str, int]:
    """Information bits of a packet by layer."""
    form = settings.transmit.formats[0] if settings.transmit.formats else AGREED
    return {name: one.codewords * one.code.k for name, one in PacketFormat(settings.signal, form).layers.items()}


@cache
def ours() -> list[tuple[Mode, float, str, float, float]]:
    """Mode, distance, right of sent codewords, bit/s, and photoelectrons per bit of "soft" at rest."""
    found: list[tuple[Mode, float, list[tuple[int, int]]]] = []
    for row in read(ROOT / "benchmarks" / "behaviour.csv"):
        if row["scenario"].startswith("static") and row["receiver"] == "soft":
            counts = [(int(row[f"{name} right"]), int(row[f"{name} sent"])) for name in LAYERS]
            found.append(("paired", float(row["scenario"].split()[1]), counts))
    for distance_m in (40.0, 60.0, 80.0, 105.0):
        total = sum((run_block(link(distance_m, "single"), seed) for seed in range(PACKETS)), BlockCounts())
        counts = [(one.codewords - one.codeword_errors, one.codewords) for one in total.layers.values()]
        found.append(("single", distance_m, counts))
    out = []
    for mode, distance_m, counts in found:
        settings = link(distance_m, mode)
        bits = sum(k * right / sent for k, (right, sent) in zip(bits_of(settings).values(), counts, strict=True))
        rate, text = bits / settings.signal.packet_s, ", ".join(f"{right}/{sent}" for right, sent in counts)
        out.append((mode, distance_m, text, rate, electrons_per_second(distance_m) / rate))
    return out


@cache
def information(mode: Mode, distance_m: float) -> float:
    """Information in bit per pattern or pair, with all other symbols known."""
    settings = link(distance_m)
    estimator = RangeEstimator(settings, settings.channel.emitter.all_on)
    parts = zip(MULTIPLICITY, LAYERS, strict=True)
    share = sum(n * estimator.information("bound", mode, name, distance_m) for n, name in parts) / sum(MULTIPLICITY)
    return settings.signal.side**2 * share


def bound(mode: Mode, distances_m: list[float]) -> tuple[list[float], list[float]]:
    """Information in bit/s, and photoelectrons per bit, with all other symbols known; all patterns carry data."""
    period_s = link(distances_m[0]).signal.pattern_period_s * (1 if mode == "single" else 2)
    rates = [information(mode, distance_m) / period_s for distance_m in distances_m]
    return rates, [electrons_per_second(z) / rate for z, rate in zip(distances_m, rates, strict=True)]


def derived(rows: list[Row]) -> dict[str, float]:
    """Photoelectrons per bit of the published systems: stated, or derived if the light is known."""
    stated = {row["system"]: float(row["electrons_bit"]) for row in rows if row["electrons_bit"]}
    paper = next(row for row in rows if row["system"] == ASSUMED)
    return {ASSUMED: electrons_per_second(float(paper["distance_m"])) / float(paper["rate_bit_s"]), **stated}


@styled
def draw(rows: list[Row], electrons: dict[str, float]) -> Figure:
    """Draw bit rates by distance (left) and by photoelectrons per information bit (right)."""
    figure = Figure(figsize=(10, 5.6))
    left, right = figure.subplots(1, 2, sharey=True)
    for mode, name in NAMES.items():
        distances_m = np.geomspace(40, 220, 12).tolist()
        rates, bound_electrons = bound(mode, distances_m)
        points = [point for point in ours() if point[0] == mode]
        for axes, line, column in ((left, distances_m, 1), (right, bound_electrons, 4)):
            axes.plot(line, rates, color=COLOURS[mode], label=f"bound, {name}")
            values = [point[column] for point in points]
            axes.plot(
                values, [point[3] for point in points], "o", color=COLOURS[mode], label=f'"soft", {name}, simulated'
            )
    kinds = {"event camera": ("D", GREEN, "event camera"), "photon counter": ("^", GRAY, "photon counter")}
    for row in rows:
        marker, color, label = kinds.get(row["camera"], ("s", RED, "other cameras"))
        places = ((left, float(row["distance_m"] or 0)), (right, electrons.get(row["system"], 0.0)))
        for axes, x in places:
            if x and row["rate_bit_s"]:
                hollow = axes is right and row["system"] == ASSUMED
                style = {"fillstyle": "none"} if hollow else {"label": label}
                axes.plot(x, float(row["rate_bit_s"]), marker, color=color, **style)
                side, align = (-4, "right") if x < 1 or 3 < x <= 50 else (4, "left")
                place, name = (x, float(row["rate_bit_s"])), row["system"].split(" (")[0]
                # a system at several distances has one label
                if name not in {text.get_text() for text in axes.texts}:
                    axes.annotate(name, place, (side, 3), textcoords="offset points", ha=align, fontsize="x-small")
    left.set(xlabel="distance in m", ylabel="information bit/s", xscale="log", yscale="log", xlim=(0.03, 3e4))
    right.set(xlabel="photoelectrons per information bit", xscale="log", xlim=(0.1, 1e6))
    legend_below(figure, columns=4)
    return figure


def page(rows: list[Row], electrons: dict[str, float]) -> str:
    """Text of the page."""
    # fmt: off
    names = ["system", "year", "transmitter", "camera", "m", "bit/s", "light", "lens", "conditions", "errors",
             "e-/bit", "source", "read"]
    # fmt: on
    lines = [f"| {' | '.join(names)} |", "|---" * len(names) + "|"]
    for row in rows:
        cells = dict(row) | {"e": f"{electrons[row['system']]:.2g}" if row["system"] in electrons else "–"}
        for key in ("distance_m", "rate_bit_s"):
            cells[key] = f"{float(row[key]):,.0f}" if row[key] else ""
        columns = {"m": "distance_m", "bit/s": "rate_bit_s", "e-/bit": "e"}
        lines.append(f"| {' | '.join(cells[columns.get(name, name)] for name in names)} |")
    head = "| format | m | codewords right: high, middle, low | information bit/s | bound | e-/bit | bound |"
    table = ['## Receiver "soft" at rest', "", head, "|---|---|---|---|---|---|---|"]
    for mode, m, text, rate, value in ours():
        (most,), (least,) = bound(mode, [m])
        table.append(f"| {NAMES[mode]} | {m:.0f} | {text} | {rate:,.0f} | {most:,.0f} | {value:,.0f} | {least:,.0f} |")
    found = "Code rate 1/3 for pairs, [results](results.md#codewords-received); 9/10 without inverses."
    return HEAD + "\n".join([*table, "", found, "", "## Table", "", *lines, ""])


if __name__ == "__main__":
    systems = read(DOCS / "published-systems.csv")
    light = derived(systems)
    (DOCS / "published-systems.md").write_text(page(systems, light))
    (DOCS / "pictures" / "published-systems.svg").write_bytes(figure_svg(draw(systems, light)))
