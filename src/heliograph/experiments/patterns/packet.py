"""Packet format.

Packets of the transmitter of the preset "paper": header pairs and data pairs, each pattern followed by the inverse.
Packets follow each other immediately.
"""

from dataclasses import dataclass
from itertools import islice

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from heliograph.experiments import plots
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, description, verdict_of
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, transmitters
from heliograph.signal.settings import LAYERS
from heliograph.transmit import Transmitter


@dataclass(frozen=True, slots=True)
class Packets:
    """Packets of a transmitter."""

    settings: LinkSettings
    sender: Transmitter
    # (packets, patterns, 16, 16) levels 0 to 4
    patterns: NDArray[np.uint8]

    @property
    def head(self) -> int:
        """Patterns of a header."""
        return 2 * self.settings.signal.header_pairs


def run(context: Context) -> ExperimentResult:
    """Check the structure of transmitted packets."""
    sent = measure(3 if context.quick else 30)
    first, head, signal = sent.patterns[0], sent.head, sent.settings.signal
    rows = [
        [name, str(form.codewords), str(form.code.k), str(form.code.length), str(form.payload_bytes)]
        for name, form in sent.sender.format.layers.items()
    ]
    names = [("header" if k < head else "data") + (", inverse" if k % 2 else "") for k in range(10)]
    return ExperimentResult(
        key="fig5",
        title="Fig. 5: packet format",
        text=description(__doc__),
        findings=[judge(sent)],
        pictures=[
            (plots.image_row(list(first[:10]), names, 2, 4), "The first patterns of a packet; white is level 4."),
            (_timeline(first, head), "The packet in time, and the mean level of each pattern."),
        ],
        tables=[
            Table(
                f"Content of a packet of {1e3 * signal.packet_s:g} ms, by layer",
                ["layer", "codewords", "bits in", "bits sent", "bytes of payload"],
                rows,
            )
        ],
        data={"patterns": signal.packet_patterns, "header": head, "layers": dict(zip(LAYERS, rows, strict=True))},
    )


def measure(count: int) -> Packets:
    """The first packets of the transmitter of the preset."""
    settings = load_settings("paper")
    sender = transmitters(settings, default_messages(settings))[0]
    return Packets(settings, sender, np.stack(list(islice(sender.packets(), count))))


def judge(sent: Packets) -> Finding:
    """Check that each packet consists of headers and of pairs of pattern and inverse."""
    count, signal = len(sent.patterns), sent.settings.signal
    pairs = sent.patterns.reshape(-1, 2, 16, 16)
    header = sent.sender.format.header_pattern(sent.sender.identity)
    inverses = int((pairs.sum(1, dtype=int) == 4).all((1, 2)).sum())
    headers = int((sent.patterns[:, 0 : sent.head : 2] == header).all((2, 3)).sum())
    return Finding(
        "Fig. 5: a packet is a header part, where the array is detected, and a data part, where it is tracked.",
        f"{headers} of {count * signal.header_pairs} header pairs are the M-sequence; in "
        f"{inverses} of {len(pairs)} pairs the second pattern is the first one's inverse; "
        f"the header takes {sent.head} of {signal.packet_patterns} patterns.",
        verdict_of(inverses == len(pairs) and headers == count * signal.header_pairs),
    )


@plots.styled
def _timeline(packet: NDArray[np.uint8], head: int) -> Figure:
    figure = Figure(figsize=(12, 2.4))
    axes = figure.add_subplot(xlabel="time (patterns of T_b)", ylabel="mean level of the LEDs")
    axes.set(xlim=(0, len(packet)), ylim=(0, 1))
    for k, mean in enumerate(packet.mean((1, 2)) / 4):
        colour = plots.BLUE if k < head else plots.ORANGE
        axes.bar(k + 0.5, mean, width=1, color=colour, alpha=0.55 if k % 2 else 0.95, lw=0)
    axes.text(head / 2, 0.75, "header", ha="center", fontsize=9, color=plots.BLUE)
    axes.text((len(packet) + head) / 2, 0.75, "data: pattern dark, inverse pale", ha="center", fontsize=9)
    return figure
