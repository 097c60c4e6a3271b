"""Simulate the recorded drive of page Watch, and receive it for the replay.

80 m to 25 m at 60 km/h, a camera window of 320 x 180 pixels.
"""

import lzma
import re
import tempfile
from collections import deque
from pathlib import Path

from heliograph.experiments.demo import demo_messages
from heliograph.link.film import write_film
from heliograph.link.settings import load_settings
from heliograph.link.truth import open_truth, truth_path
from heliograph.measure.reception import ReceptionCounter
from heliograph.media import open_film
from heliograph.web import replay
from heliograph.web.recorded_drive import RECORDED_DRIVE

SETTINGS = [
    "channel.camera.width=320", "channel.camera.height=180", "channel.speed_m_s=16.7", "channel.arrays.0.x_m=0.6",
    "channel.arrays.0.y_m=0", "channel.background.kind=street",
]  # fmt: skip


def record() -> None:
    """Receive the film and keep the run."""
    settings = load_settings("paper", None, [*SETTINGS, "receive.receiver=soft"])
    replay.MAX_BYTES = 3_000_000
    with open_film(RECORDED_DRIVE) as film, tempfile.TemporaryDirectory() as folder:
        page, counter = Path(folder) / "run.html", ReceptionCounter(open_truth(truth_path(RECORDED_DRIVE)))
        deque(replay.receive_and_record(page, film, settings.signal, settings, counter), maxlen=0)
        run = re.search(r'id="run">(.*?)</script>', page.read_text(encoding="utf-8"), re.DOTALL)
    assert run is not None
    replay.RECORDED_RUN.write_bytes(lzma.compress(run[1].encode(), preset=9))


if __name__ == "__main__":
    settings = load_settings("paper", None, SETTINGS)
    # 2.4 MB; the receiver "soft" reads all codewords, as in the film without loss
    write_film(RECORDED_DRIVE, settings, demo_messages(settings), seed=1, crf=22)
    record()
