"""Simulate the recorded drive of page Watch: 80 m to 25 m at 60 km/h, a camera window of 320 x 180 pixels."""

from heliograph.experiments.demo.drive import demo_messages
from heliograph.link.film import write_film
from heliograph.link.settings import load_settings
from heliograph.web.recorded_drive import RECORDED_DRIVE

SETTINGS = [
    "channel.camera.width=320", "channel.camera.height=180", "channel.speed_m_s=16.7", "channel.arrays.0.x_m=0.6",
    "channel.arrays.0.y_m=0", "channel.background.kind=street",
]  # fmt: skip

if __name__ == "__main__":
    settings = load_settings("paper", None, SETTINGS)
    # 2.4 MB; the receiver "soft" reads all codewords, as in the film without loss
    write_film(RECORDED_DRIVE, settings, demo_messages(settings), seed=1, crf=22)
