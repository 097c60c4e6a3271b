"""Use an 8 x 8 LED array, such as a hobby matrix module, from message to plot.

Run `python examples/eight_by_eight.py`. The script writes patterns for a panel (eight_by_eight.csv), simulates a film
and receives the message. eight_by_eight.png shows the first patterns, a frame and the range of each layer. The script
requires `pip install '.[analysis]'` in a clone.
"""

import sys
from itertools import islice

import numpy as np
from matplotlib.figure import Figure

import heliograph

SMALL = [
    "signal.side=8",
    "transmit.identities=[5]",
    "channel.distance_m=20",
    "channel.duration_s=0.25",
    "channel.camera.width=512",
    "channel.camera.height=384",
    "receive.receiver='soft'",
]
"""Panel and film settings. A packet holds a quarter of the bits for 16 x 16 LEDs."""

MESSAGE = {"high": [b"stop"], "middle": [b"lift 3 is free"], "low": [b"the museum closes at six"]}


def write_patterns(settings: heliograph.LinkSettings) -> np.ndarray:
    """Write the first packet, one pattern per line; return the levels (patterns, 8, 8)."""
    light = heliograph.Transmitter(settings.signal, 5, MESSAGE)
    levels = np.stack(list(islice(light.levels(), settings.signal.packet_patterns)))
    np.savetxt("eight_by_eight.csv", levels.reshape(len(levels), -1), fmt="%d", delimiter=",")
    return levels


def film_and_receive(settings: heliograph.LinkSettings) -> heliograph.Frame:
    """Simulate a film, print decoded packets, and return a frame."""
    frames = [frame for frame, _ in heliograph.simulate(settings, [MESSAGE], seed=1)]
    for packet in heliograph.receive_frames(frames, settings.signal, settings.receive):
        words = {layer: "".join("." if word.status == "ok" else "x" for word in found)
                 for layer, found in packet.layers.items()}  # fmt: skip
        print(f"array {packet.identity} at {packet.distance_m:.2f} m: {packet.status} {words}")
    return frames[0]


def main(few: bool) -> None:
    """Transmit, receive and plot."""
    settings = heliograph.load_settings("static", assignments=SMALL)
    levels = write_patterns(settings)
    frame = film_and_receive(settings)
    data = heliograph.sweep(
        {"signal.side": [8, 16], "channel.distance_m": [20] if few else [40, 50, 60, 70, 80]},
        set={"receive.detect.min_side_px": 4},
        min_errors=5 if few else 30,
        max_codewords=1 if few else 40,
    )
    figure = Figure(figsize=(11, 3.5), layout="constrained")
    panels, film, rates = figure.subplots(1, 3)
    panels.imshow(np.block([[levels[0], levels[1]], [levels[4], levels[5]]]), "gray")
    panels.set(title="header and data, each with its inverse", xticks=[], yticks=[])
    film.imshow(frame.pixels, "gray")
    film.set(title="the camera's frame, 20 m", xticks=[], yticks=[])
    for side in data["signal.side"].values:
        at = data.sel({"signal.side": side, "layer": "middle"})
        rate, low, high = at.fer.values, at.fer_low.values, at.fer_high.values
        rates.errorbar(at["channel.distance_m"], rate, [rate - low, high - rate], label=f"{side} x {side}", capsize=3)
        counts = zip(at["channel.distance_m"], at.codeword_errors, at.codewords, strict=True)
        print(f"{side} x {side}, middle:", {int(z): f"{int(wrong)}/{int(sent)}" for z, wrong, sent in counts})
    rates.set(title="middle layer", xlabel="distance (m)", ylabel="codeword error rate", ylim=(-0.02, 1.02))
    rates.legend()
    figure.savefig("eight_by_eight.png", dpi=120)


if __name__ == "__main__":
    main("--few" in sys.argv)
