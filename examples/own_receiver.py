"""A receiver of one's own: a threshold, a bounding box and a resize by OpenCV, beside the package's two receivers.

Run it as it is: `python examples/own_receiver.py` counts codeword errors of all three over distance, and draws them
into own_receiver.png. It needs `pip install heliograph[analysis]`. The same file serves the command line:
`heliograph --load examples/own_receiver.py receive film.mkv --receiver threshold`.
"""

import sys
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import heliograph
from heliograph.receive import Packet, Pose, ReceiveSettings, own_settings
from heliograph.receive.decode.codeword import decode_packet
from heliograph.signal.header import all_header_cells
from heliograph.signal.packet import PacketFormat


@dataclass(frozen=True)
class ThresholdSettings:
    """What may be tuned: `--set receive.own.level=0.2`, or `--vary receive.own.level=0.1,0.2,0.4` in a sweep."""

    level: float = 0.2
    """Fraction of the largest change from which on a pixel belongs to the array."""


class Threshold:
    """Reads one array that blinks: the box of what changes, resized to a pixel an LED."""

    def __init__(self, signal: heliograph.SignalSettings, settings: ReceiveSettings, observe: Any):
        self._form, self._own = PacketFormat(signal), own_settings(settings)
        self._headers = all_header_cells().reshape(-1, 16).astype(np.float64)
        self._calibration, self._observe = settings.calibration, observe
        self._frames: deque[heliograph.Frame] = deque(maxlen=signal.packet_patterns)

    def push(self, frame: heliograph.Frame) -> Iterator[Packet]:
        """Take the next frame; yield the packet whose last frame it is."""
        self._frames.append(frame)
        if len(self._frames) < (self._frames.maxlen or 0):
            return
        first, second = (self._frames[k].pixels.astype(np.float32) for k in (0, 1))
        if first.shape != second.shape:
            return
        left, top, width, height = cv2.boundingRect(self._changed(first - second))
        if min(width, height) < self._form.settings.side // 2:
            return
        seen = self._leds(0, (left, top, width, height), 4).ravel() @ self._headers.T
        identity = int(np.argmax(seen))
        if seen[identity] < 0.8 * np.abs(self._leds(0, (left, top, width, height), 4)).sum():
            return
        yield self._packet(identity, (left, top, width, height))

    def finish(self) -> Iterator[Packet]:
        """Nothing is left: packets are read whole."""
        yield from ()

    def _changed(self, change: NDArray[np.float32]) -> NDArray[np.uint8]:
        size = np.abs(change)
        return (size > self._own.level * size.max()).astype(np.uint8)

    def _leds(self, pair: int, box: tuple[int, int, int, int], side: int) -> NDArray[np.float64]:
        """Change from a pattern to its inverse, (side, side)."""
        left, top, width, height = box
        one, two = (self._frames[2 * pair + k].pixels[top : top + height, left : left + width] for k in (0, 1))
        change = one.astype(np.float32) - two
        return np.asarray(cv2.resize(change, (side, side), interpolation=cv2.INTER_AREA), np.float64)

    def _packet(self, identity: int, box: tuple[int, int, int, int]) -> Packet:
        signal, first = self._form.settings, self._frames[0]
        pairs = range(signal.header_pairs, signal.header_pairs + signal.data_pairs)
        luminances = np.stack([self._leds(pair, box, signal.side) for pair in pairs])
        layers = decode_packet(luminances, np.ones(len(pairs), bool), self._form, identity)
        good = [word.status == "ok" for words in layers.values() for word in words]
        pitch, calibration = max(box[2:]) / signal.side, self._calibration
        pose = Pose(box[0] + box[2] / 2 + first.origin[0], box[1] + box[3] / 2 + first.origin[1], pitch)
        distance_m = calibration.focal_m * calibration.pitch_m / (pitch * calibration.pixel_m)
        status = "ok" if all(good) else "partial" if any(good) else "crc_fail"
        numbers = first.index, self._frames[-1].index
        self._frames.clear()
        return Packet(identity, status, first.time_s, *numbers, pose, distance_m, 1.0, 1.0, 1.0, layers)


heliograph.register_receiver("threshold", Threshold, ThresholdSettings, reads=["calibration"])


def main(few: bool) -> None:
    """Compare the three receivers."""
    data = heliograph.sweep(
        {
            "receiver": ["threshold", "plain", "soft"],
            "channel.distance_m": [20, 60] if few else [15, 30, 40, 50, 60, 80],
        },
        set={"signal.data_pairs": 16 if few else 48},
        min_errors=5 if few else 30,
        max_codewords=4 if few else 60,
    )
    figure = Figure(figsize=(10, 3.5), layout="constrained")
    for axes, layer in zip(figure.subplots(1, 3, sharey=True), data.layer.values, strict=True):
        for receiver in data["receiver"].values:
            at = data.sel({"receiver": receiver, "layer": layer})
            rate, low, high = at.fer.values, at.fer_low.values, at.fer_high.values
            axes.errorbar(at["channel.distance_m"], rate, [rate - low, high - rate], label=receiver, capsize=3)
            counts = zip(at["channel.distance_m"], at.codeword_errors, at.codewords, strict=True)
            print(receiver, layer, {int(z): f"{int(wrong)}/{int(sent)}" for z, wrong, sent in counts})
        axes.set(title=f"{layer} priority", xlabel="distance (m)", ylim=(-0.02, 1.02))
    figure.axes[0].set_ylabel("codeword error rate")
    figure.axes[0].legend()
    figure.savefig("own_receiver.png", dpi=120)


if __name__ == "__main__":
    main("--few" in sys.argv)
