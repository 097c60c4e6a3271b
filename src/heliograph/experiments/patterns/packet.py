"""Packet format.

Packets of the transmitter of the preset "paper": header pairs and data pairs, each pattern followed by the inverse.
Packets follow each other immediately.
"""

from itertools import islice

import numpy as np
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from numpy.typing import NDArray

from heliograph.experiments import plots
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, verdict_of
from heliograph.link.settings import load_settings
from heliograph.link.simulate import default_messages, transmitters


def run(context: Context) -> ExperimentResult:
    """Check that each packet consists of headers and of pairs of pattern and inverse."""
    settings, count = load_settings("paper"), 3 if context.quick else 30
    signal, sender = settings.signal, transmitters(settings, default_messages(settings))[0]
    patterns, head = np.stack(list(islice(sender.packets(), count))), 2 * settings.signal.header_pairs
    pairs = patterns.reshape(-1, 2, 16, 16)
    inverses = int((pairs.sum(1, dtype=int) == 4).all((1, 2)).sum())
    headers = int((patterns[:, 0:head:2] == sender.format.header_pattern(sender.identity)).all((2, 3)).sum())
    finding = Finding(
        "Fig. 5: a packet is a header part, where the array is detected, and a data part, where it is tracked.",
        f"{headers} of {count * signal.header_pairs} header pairs are the M-sequence; in "
        f"{inverses} of {len(pairs)} pairs the second pattern is the first one's inverse; "
        f"the header takes {head} of {signal.packet_patterns} patterns.",
        verdict_of(inverses == len(pairs) and headers == count * signal.header_pairs),
    )
    rows = [
        [name, *map(str, (form.codewords, form.code.k, form.code.length, form.payload_bytes))]
        for name, form in sender.format.layers.items()
    ]
    names = [("header" if k < head else "data") + (", inverse" if k % 2 else "") for k in range(10)]
    columns = ["layer", "codewords", "bits in", "bits sent", "bytes of payload"]
    return ExperimentResult(
        findings=[finding],
        pictures=[
            (plots.image_row(list(patterns[0, :10]), names, 2, 4), "The first patterns of a packet; white is level 4."),
            (_timeline(patterns[0], head), "The packet in time, and the mean level of each pattern."),
        ],
        tables=[Table(f"Content of a packet of {1e3 * signal.packet_s:g} ms, by layer", columns, rows)],
        data={"patterns": signal.packet_patterns, "header": head, "layers": {row[0]: row for row in rows}},
    )


def _timeline(packet: NDArray[np.uint8], head: int) -> Figure:
    figure = Figure(figsize=(10, 2.4))
    axes = figure.add_subplot(xlabel="time (patterns of T_b)", ylabel="mean level of the LEDs")
    axes.set(xlim=(0, len(packet)), ylim=(0, 1))
    means, numbers = packet.mean((1, 2)) / 4, np.arange(len(packet))
    colours = [to_rgba(plots.BLUE if k < head else plots.ORANGE, 0.55 if k % 2 else 0.95) for k in numbers]
    axes.bar(numbers + 0.5, means, width=1, color=colours, lw=0)
    axes.text(head / 2, 0.75, "header", ha="center", fontsize=9, color=plots.BLUE)
    axes.text((len(packet) + head) / 2, 0.75, "data: pattern dark, inverse pale", ha="center", fontsize=9)
    return figure
