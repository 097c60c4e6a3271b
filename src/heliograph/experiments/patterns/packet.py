"""Fig. 5: the packet format."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from heliograph.experiments import plots
from heliograph.experiments.result import Chapter, Context, Finding, Table
from heliograph.link.settings import load_settings
from heliograph.link.simulate import default_messages, transmitters
from heliograph.signal.settings import LAYERS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = 10

TEXT = (
    "A packet as the transmitter of the preset sends it: header pairs, then data pairs, each pattern followed by its "
    "inverse. Packets follow each other without a gap."
)


def run(context: Context) -> Chapter:
    """Take packets from the transmitter and check their build."""
    settings = load_settings("paper")
    sender = transmitters(settings, default_messages(settings))[0]
    source, count = sender.packets(), 3 if context.quick else 30
    packets = np.stack([next(source) for _ in range(count)])
    head = 2 * settings.signal.header_pairs
    pairs = packets.reshape(count, -1, 2, 16, 16)
    inverses = int((pairs.sum(2, dtype=int) == 4).all((2, 3)).sum())
    headers = int((packets[:, 0:head:2] == sender.format.header_pattern(sender.identity)).all((2, 3)).sum())
    whole = inverses == pairs.shape[0] * pairs.shape[1] and headers == count * settings.signal.header_pairs
    rows = [
        [name, str(form.codewords), str(form.code.k), str(form.code.length), str(form.payload_bytes)]
        for name, form in sender.format.layers.items()
    ]
    return Chapter(
        key="fig5",
        title="Fig. 5: packet format",
        text=TEXT,
        findings=[
            Finding(
                "Fig. 5: a packet is a header part, where the array is detected, and a data part, where it is tracked.",
                f"{headers} of {count * settings.signal.header_pairs} header pairs are the M-sequence; in "
                f"{inverses} of {pairs.shape[0] * pairs.shape[1]} pairs the second pattern is the first one's inverse; "
                f"the header takes {head} of {settings.signal.packet_patterns} patterns.",
                "holds" if whole else "differs",
            )
        ],
        pictures=[
            (_strip(packets[0], head), "The first patterns of a packet; white is level 4."),
            (_timeline(packets[0], head), "The packet in time, and the mean level of each pattern."),
        ],
        tables=[
            Table(
                f"What a packet of {1e3 * settings.signal.packet_s:g} ms carries, by layer",
                ["layer", "codewords", "bits in", "bits sent", "bytes of payload"],
                rows,
            )
        ],
        data={
            "patterns": settings.signal.packet_patterns,
            "header": head,
            "layers": dict(zip(LAYERS, rows, strict=True)),
        },
    )


def _strip(packet: NDArray[np.uint8], head: int) -> "Figure":
    names = [("header" if k < head else "data") + (", inverse" if k % 2 else "") for k in range(SHOWN)]
    return plots.image_row(list(packet[:SHOWN]), names, rows=2, largest=4)


def _timeline(packet: NDArray[np.uint8], head: int) -> "Figure":
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 2.4))
    axes = figure.add_subplot()
    for k, mean in enumerate(packet.mean((1, 2)) / 4):
        colour = "#1b6ca8" if k < head else "#d1741f"
        axes.bar(k + 0.5, mean, width=1, color=colour, alpha=0.55 if k % 2 else 0.95, lw=0)
    axes.set(xlim=(0, len(packet)), ylim=(0, 1), xlabel="time (patterns of T_b)", ylabel="LEDs' mean level")
    axes.text(head / 2, 0.75, "header", ha="center", fontsize=9, color="#1b6ca8")
    axes.text((len(packet) + head) / 2, 0.75, "data: pattern dark, inverse pale", ha="center", fontsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    return figure
