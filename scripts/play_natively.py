"""Play recordings to the receiver a frame a pattern: `python scripts/play_natively.py VIDEO ...`.

A simulated film fades from one frame of a recording to the next in many steps, which the detector's third difference
cancels but for the shake. Here nothing is faded, and all that moves does so some forty times as fast as it did.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

from heliograph.base.frames import Frame
from heliograph.link.settings import load_settings
from heliograph.media import open_film
from heliograph.receive import Packet, Receiver


def main() -> None:
    settings = load_settings("paper")
    size = settings.channel.camera.width, settings.channel.camera.height
    for path in map(Path, sys.argv[1:]):
        receiver, count = Receiver(settings.signal, settings.receive), 0
        packets: list[Packet] = []
        with open_film(path, expand_range=True) as film:
            for frame in film:
                pixels = np.asarray(cv2.resize(frame.pixels, size, interpolation=cv2.INTER_AREA), np.uint8)
                packets += receiver.push(Frame(count, count * settings.signal.pattern_period_s, pixels))
                count += 1
        packets += receiver.finish()
        right = sum(w.status == "ok" for p in packets for words in p.layers.values() for w in words)
        print(f"{path.name}: {count} frames, {receiver.detections} detections, {right} right codewords", flush=True)


if __name__ == "__main__":
    main()
