"""Register a custom receiver: threshold, bounding box and resize with OpenCV.

Run `python examples/own_receiver.py`. The script counts codeword errors for this receiver and both built-in receivers
over distance and plots the rates in own_receiver.png. The script requires `pip install xarray pandas h5netcdf`. The
file also extends the command line:
`heliograph --load examples/own_receiver.py receive film.mkv --receiver threshold`.
"""

import sys
from collections import deque
from collections.abc import Iterator, Sequence
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

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ThresholdSettings:
    """Settings for `--set receive.custom.level=0.2`, or `--vary receive.custom.level=0.1,0.2,0.4` in a sweep."""

    level: float = 0.2
    """Threshold for array pixels, as a fraction of the largest change."""


class Threshold:
    """Reads one array that blinks: the box of what changes, resized to a pixel an LED."""

    def __init__(self, signal: heliograph.SignalSettings, settings: ReceiveSettings, _observe: Any):
        self._form, self._own, self._calibration = PacketFormat(signal), own_settings(settings), settings.calibration
        self._headers = all_header_cells().reshape(-1, 16)
        self._frames = deque[heliograph.Frame](maxlen=signal.packet_patterns)

    def push(self, frame: heliograph.Frame) -> Iterator[Packet]:
        """Take the next frame; yield the packet whose last frame it is."""
        self._frames.append(frame)
        places = {(one.origin, one.pixels.shape) for one in self._frames}  # a window may move
        if len(self._frames) < self._form.settings.packet_patterns or len(places) > 1:
            return
        size = np.abs(self._change(0))
        box = cv2.boundingRect((size >= self._own.level * size.max()).astype(np.uint8))
        header = self._leds(0, box, 4)
        matches = self._headers @ header.ravel()
        if matches.max() > 0.8 * np.abs(header).sum():
            yield self._packet(int(matches.argmax()), box)
            self._frames.clear()

    def finish(self) -> Iterator[Packet]:
        """Nothing is left: packets are read whole."""
        yield from ()

    def _change(self, pair: int) -> Floats:
        """Change from a pattern to its inverse, in gray levels."""
        one, two = self._frames[2 * pair], self._frames[2 * pair + 1]
        return cv2.subtract(one.pixels, two.pixels, dtype=cv2.CV_64F)

    def _leds(self, pair: int, box: Sequence[int], side: int) -> Floats:
        """The same within the box, (side, side)."""
        left, top, width, height = box
        inside = self._change(pair)[top : top + height, left : left + width]
        return cv2.resize(inside, (side, side), interpolation=cv2.INTER_AREA)

    def _packet(self, identity: int, box: Sequence[int]) -> Packet:
        """Decode all data pairs; size and place of the box give the pose, its size the distance."""
        signal, lens, first, last = self._form.settings, self._calibration, self._frames[0], self._frames[-1]
        pairs = signal.header_pairs + np.arange(signal.data_pairs)
        luminances = np.stack([self._leds(pair, box, signal.side) for pair in pairs])
        layers = decode_packet(luminances, np.full(len(pairs), True), self._form, identity)
        good = [word.status == "ok" for words in layers.values() for word in words]
        status = "ok" if all(good) else "partial" if any(good) else "crc_fail"
        pitch = max(box[2:]) / signal.side
        pose = Pose(first.origin[0] + box[0] + box[2] / 2, first.origin[1] + box[1] + box[3] / 2, pitch)
        distance_m = lens.focal_m * lens.pitch_m / (pitch * lens.pixel_m)
        return Packet(identity, status, first.time_s, first.index, last.index, pose, distance_m, 1.0, 1.0, 1.0, layers)


heliograph.register_receiver("threshold", Threshold, ThresholdSettings, reads=["calibration"])


def main(few: bool) -> None:
    """Compare the three receivers."""
    data = heliograph.sweep(
        {
            "receiver": ["threshold", "plain", "soft"],
            "channel.distance_m": [20] if few else [15, 30, 40, 50, 60, 80],
        },
        set={"signal.data_pairs": 16 if few else 48},
        min_errors=5 if few else 30,
        max_codewords=2 if few else 60,
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
