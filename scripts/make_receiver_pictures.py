"""Make the pictures of docs/theory.md: each stage of the soft receiver on a packet, and how well it does."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray
from observe_oracle import transform
from render_oracle import blur_matrix

from heliograph.experiments.plots import GRAY, figure_svg, image_row, styled
from heliograph.link.budget import REQUIRED_INFORMATION
from heliograph.link.settings import load_settings
from heliograph.link.simulate import default_messages, simulate, transmitters
from heliograph.receive.api import make_receiver
from heliograph.receive.events import DecodeEvent, EqualiseEvent, Event
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.observe.cutout import Cutout, Noise
from heliograph.receive.observe.statistics import whiten
from heliograph.signal.block import pack
from heliograph.signal.settings import LAYERS
from heliograph.sweeps.plot import LAYER_COLOURS

Floats = NDArray[np.float64]

PICTURES = Path(__file__).parents[1] / "docs" / "pictures"
SIDE, PITCH_M_PX = 16, 58.33
"""LEDs in a row; pitch in px times distance in m of the reference link."""


class Packet:
    """Packet received from a fixed distance: sent bits, cut-outs and iterations of the receiver."""

    def __init__(self, distance_m: float, *other: str, seed: int = 0):
        changes = [f"channel.distance_m={distance_m}", "channel.duration_s=0.1", "receive.receiver=soft", *other]
        settings = load_settings("static", None, changes)
        messages = default_messages(settings)
        self.iterations: list[dict[str, Floats]] = []
        self.cutouts: list[Cutout] = []
        receiver = make_receiver(settings.signal, settings.receive, self._watch)
        for frame, _ in simulate(settings, messages, seed, roi_margin_px=12):
            list(receiver.push(frame))
        list(receiver.finish())
        (sender,) = transmitters(settings, messages)
        blocks, layers = sender.blocks(0), sender.format.layers
        self.sent = {n: layers[n].code.encode([pack(b, layers[n].code.k) for b in blocks[n]]) for n in LAYERS}
        bits = np.concatenate([layers[n].encode(blocks[n]) for n in LAYERS], axis=1)
        self.symbols = 1.0 - 2.0 * bits

    def information(self, name: str, word: int) -> tuple[NDArray[np.intp], list[float]]:
        """Return the iterations of an open codeword, and the information in the LLRs given the sent bits."""
        llr = np.array([one[name][word] for one in self.iterations])
        sent = 1.0 - 2.0 * self.sent[name][word]
        open_ = np.flatnonzero((llr != 0).any(1))
        return 1 + open_, [float(1 - np.mean(np.logaddexp(0, -row * sent)) / np.log(2)) for row in llr[open_]]

    def _watch(self, event: Event) -> None:
        if isinstance(event, EqualiseEvent):
            self.iterations.append({name: llr.copy() for name, llr in event.llr.items()})
        if isinstance(event, DecodeEvent):
            self.cutouts = [cutout for cutout in event.cutouts if cutout is not None]


def pair(packet: Packet, number: int = 5) -> Figure:
    """Draw a pair as filmed, and the residual after subtracting the light of all symbols."""
    cutout = packet.cutouts[number]
    total, change = cutout.total, cutout.difference
    symbols = packet.symbols[number]
    whitened = whiten(cutout, Noise(1.0, 1.0), SIDE)
    # the gain that explains the difference best
    light = -whitened.residual(1.0, symbols) + whitened.difference
    gain = float((light * whitened.difference).sum() / (light * light).sum())
    left = whitened.residual(gain, symbols)
    images = [0.5 * (total + change), 0.5 * (total - change), total / 2, 127 + change, 127 + left, 127 + 8 * left]
    names = ["pattern", "inverse", "sum / 2", "difference d", "d - g (B c + o)", "d - g (B c + o), x 8"]
    return image_row(images, names, rows=2)


def gram() -> Figure:
    """B^T B by distance: how far symbols can be told apart."""
    figure = Figure(figsize=(9, 3), layout="constrained")
    t = transform(SIDE)
    for k, z in enumerate((40, 80, 120)):
        half = 8 * PITCH_M_PX / z + 4
        size = int(2 * half)
        a = blur_matrix(Pose(half, half, PITCH_M_PX / z, 0.0, 0.51), SIDE, (0, 0), (size, size))
        values = (a @ t).T @ (a @ t)
        axes = figure.add_subplot(1, 3, k + 1)
        shown = axes.imshow(np.abs(values) / values.max(), norm=LogNorm(1e-4, 1), cmap="magma")
        axes.set_title(f"{z} m")
        axes.grid(visible=False)
        axes.set_xticks([32, 128, 224], ["high", "middle", "low"])
        axes.set_yticks([32, 128, 224], ["high", "middle", "low"] if k == 0 else [""] * 3)
    figure.colorbar(shown, ax=figure.axes, label="|B$^T$B|, relative to the largest", shrink=0.8)
    return figure


def iterations(packet: Packet) -> Figure:
    """Information on each layer by iteration."""
    figure = Figure(figsize=(7.5, 3.2))
    axes = figure.subplots()
    for name in LAYERS:
        for word in range(len(packet.sent[name])):
            axes.plot(*packet.information(name, word), "o-", color=LAYER_COLOURS[name], label=None if word else name)
    _finish(axes, len(packet.iterations))
    return figure


def sites(kinds: Mapping[str, Packet]) -> Figure:
    """Information on the high layer by iteration, symbols taken as Gaussian and as -1 and +1."""
    figure = Figure(figsize=(7.5, 3.2))
    axes = figure.subplots()
    for (name, packet), style in zip(kinds.items(), ("o--", "o-"), strict=True):
        axes.plot(*packet.information("high", 0), style, color=LAYER_COLOURS["high"], label=name)
    _finish(axes, max(len(packet.iterations) for packet in kinds.values()))
    return figure


def _finish(axes: Axes, count: int) -> None:
    """Name the axes of information by iteration."""
    axes.axhline(REQUIRED_INFORMATION[0][1], color=GRAY, lw=1, ls="--", label="needed at rate 1/3")
    axes.set(xlabel="iteration", ylabel="information (bit per coded bit)", xticks=range(1, 1 + count))
    axes.legend(loc="upper left", bbox_to_anchor=(1, 1))


@styled
def main() -> None:
    PICTURES.mkdir(exist_ok=True)
    gaussian = Packet(230, "receive.soft.feedback=soft")
    kinds = {"Gaussian symbols": gaussian, "symbols of -1 and +1": Packet(230)}
    for name, figure in (
        ("pair", pair(Packet(60))),
        ("gram", gram()),
        ("iterations", iterations(Packet(115, "receive.soft.led_by_led=false"))),
        ("sites", sites(kinds)),
    ):
        (PICTURES / f"soft-{name}.svg").write_bytes(figure_svg(figure))


if __name__ == "__main__":
    main()
