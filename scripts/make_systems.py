"""Make docs/published-systems.md and its figure: `python scripts/make_systems.py`."""

import csv
from functools import cache
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from heliograph.experiments.plots import BLUE, GREEN, ORANGE, RED, figure_svg, legend_below, styled
from heliograph.link.budget import RangeEstimator, budget
from heliograph.link.settings import load_settings
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import LAYERS

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
Row = dict[str, str]

HEAD = """# Published systems

Systems of other publications beside the receiver "soft" in the reference link, simulated. `read` says whether the
numbers come from a paper's text, its abstract, or a citation. Empty cells are not stated there.
`scripts/make_systems.py` makes this page from [published-systems.csv](published-systems.csv).

![Rate and photoelectrons per information bit against distance](pictures/published-systems.svg)

## Photoelectrons per information bit

The electrons that the light of the array frees in the sensor, over the information bits that arrive:

    e = n^2 E_led(Z) P / (2 k)

with n^2 LEDs, E_led electrons per exposure of a lit LED (`heliograph budget`, column `e-/LED`), P patterns per
packet, half of the LEDs lit on average, and k information bits of the codewords that arrive. `heliograph budget`
prints the value for k of all codewords as `e-/bit`.

The bound has the mutual information of each symbol with all others, pose and blur known
([budget](budget.md#range)), summed over the symbols, in place of k.

**No abstract or text read states the light at the lens**: intensity, f-number, exposure and efficiency together.
The value of Nagura et al. is derived with the light of the reference link, 16 kbit/s and 80 m. All others are
marked with a dash.

"""


def read(path: Path) -> list[Row]:
    """Read a table."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@cache
def ours() -> list[tuple[float, float, float]]:
    """Distance, information bits per second, and photoelectrons per information bit of "soft" at rest."""
    out = []
    for row in read(ROOT / "benchmarks" / "behaviour.csv"):
        if row["scenario"].startswith("static") and row["receiver"] == "soft":
            distance_m = float(row["scenario"].split()[1])
            settings = load_settings("static", {"channel": {"distance_m": distance_m}})
            layers = PacketFormat(settings.signal).layers.values()
            total = sum(layer.codewords * layer.code.k for layer in layers)
            bits = sum(
                layer.codewords * layer.code.k * int(row[f"{layer.name} right"]) / int(row[f"{layer.name} sent"])
                for layer in layers
            )
            electrons_bit = budget(settings).spot.electrons_bit * total / bits
            out.append((distance_m, bits / settings.signal.packet_s, electrons_bit))
    return out


def bound(distances_m: list[float]) -> tuple[list[float], list[float]]:
    """Information in bit/s, and photoelectrons per bit, of pairs with all other symbols known."""
    rates, electrons = [], []
    for distance_m in distances_m:
        settings = load_settings("static", {"channel": {"distance_m": distance_m}})
        layers = PacketFormat(settings.signal).layers
        estimator = RangeEstimator(settings, settings.channel.emitter.all_on)
        bits = sum(
            layers[name].pairs * layers[name].symbols * estimator.information("bound", "paired", name, distance_m)
            for name in LAYERS
        )
        total = sum(layer.codewords * layer.code.k for layer in layers.values())
        rates.append(bits / settings.signal.packet_s)
        electrons.append(budget(settings).spot.electrons_bit * total / bits)
    return rates, electrons


def derived(rows: list[Row]) -> dict[str, float]:
    """Photoelectrons per bit of the published systems whose light is known."""
    paper = next(row for row in rows if row["system"] == "Nagura et al.")
    settings = load_settings("static", {"channel": {"distance_m": float(paper["distance_m"])}})
    electrons_s = settings.signal.side**2 * budget(settings).spot.electrons_led / 2 / settings.signal.pattern_period_s
    return {paper["system"]: electrons_s / float(paper["rate_bit_s"])}


@styled
def draw(rows: list[Row], electrons: dict[str, float]) -> Figure:
    """Draw rate and photoelectrons per bit against distance."""
    figure = Figure(figsize=(10, 4.6))
    left, right = figure.subplots(1, 2)
    distances_m, points = np.geomspace(25, 240, 14).tolist(), np.array(ours())
    for axes, line, column in zip((left, right), bound(distances_m), (1, 2), strict=True):
        axes.loglog(distances_m, line, color=ORANGE, label="bound of the reference link")
        axes.loglog(points[:, 0], points[:, column], "o", color=BLUE, label='"soft", simulated')
    kinds = {"event camera": ("D", GREEN, "event camera"), "": ("s", RED, "other cameras")}
    for row in rows:
        marker, color, label = kinds.get(row["camera"], kinds[""])
        if row["distance_m"] and row["rate_bit_s"]:
            values = {left: float(row["rate_bit_s"])}
            if row["system"] in electrons:
                values[right] = electrons[row["system"]]
            for axes, value in values.items():
                place, name = (float(row["distance_m"]), value), row["system"].split(" (")[0]
                axes.plot(*place, marker, color=color, label=label)
                axes.annotate(name, place, (4, 4), textcoords="offset points", fontsize="small")
    left.set(xlabel="distance in m", ylabel="information bit/s", xlim=(8, 1e4))
    right.set(xlabel="distance in m", ylabel="photoelectrons per information bit")
    right.set_xticks([25, 50, 100, 200], ["25", "50", "100", "200"])
    right.set_xticks([], minor=True)
    legend_below(figure)
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
    table = ['## Receiver "soft" at rest', "", "| m | information bit/s | e-/bit |", "|---|---|---|"]
    table += [f"| {m:.0f} | {rate:,.0f} | {value:,.0f} |" for m, rate, value in ours()]
    found = "Codewords right of those sent: [results](results.md#codewords-received)."
    return HEAD + "\n".join([*table, "", found, "", "## Table", "", *lines, ""])


if __name__ == "__main__":
    systems = read(DOCS / "published-systems.csv")
    light = derived(systems)
    (DOCS / "published-systems.md").write_text(page(systems, light))
    (DOCS / "pictures" / "published-systems.svg").write_bytes(figure_svg(draw(systems, light)))
