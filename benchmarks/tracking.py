"""Error of the tracked pose over a drive: `python -m benchmarks.tracking [VIDEO IMU_CSV]`."""

import sys
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.link.settings import load_settings
from heliograph.link.simulate import Recordings, default_messages, load_footage, load_imu, simulate
from heliograph.receive import make_receiver
from heliograph.receive.events import Event, TrackEvent

BIN_M = 10

PULLED_PX = 0.05
"""Error of y from which on a pair counts as pulled by an edge of the background. Chosen: just above the largest of a
drive on the road, 0.047 px, where no edge pulls."""


def main() -> None:
    recorded = sys.argv[1:3] if len(sys.argv) == 3 else []
    changes = ["channel.shake='imu'", "channel.background.kind='footage'"] if recorded else []
    settings = load_settings("paper", assignments=changes)
    recordings = Recordings()
    if recorded:
        recordings = Recordings(footage=load_footage(Path(recorded[0])), imu=load_imu(Path(recorded[1])))
    poses: list[tuple[int, Any]] = []

    def watch(event: Event) -> None:
        if isinstance(event, TrackEvent):
            poses.append((event.frame, event.view.pose_out(event.tracked.state.pose)))

    receiver = make_receiver(settings.signal, settings.receive, watch)
    truth = {}
    for frame, row in simulate(settings, default_messages(settings), 2, recordings):
        truth[frame.index] = row.arrays[0]
        list(receiver.push(frame))
    errors = np.array([_error(pose, truth[k], truth[k + 1]) for k, pose in poses])
    print(
        "distance    pairs   rms error: x px  y px  pitch %   99.9 % of |x, y| px   y: largest px, pulled, rms of rest"
    )
    for start in range(20, 100, BIN_M):
        part = errors[(errors[:, 3] >= start) & (errors[:, 3] < start + BIN_M)]
        if len(part):
            x, y, pitch = np.sqrt(np.mean(part[:, :3] ** 2, axis=0))
            worst = np.quantile(np.hypot(part[:, 0], part[:, 1]), 0.999)
            down = np.abs(part[:, 1])
            rest = down[down <= PULLED_PX]
            print(
                f"{start:3d}-{start + BIN_M:3d} m {len(part):6d}  {x:.4f} {y:.4f} {100 * pitch:.3f}  {worst:.3f}  "
                f"{down.max():.3f} {len(part) - len(rest)} {np.sqrt(np.mean(rest**2)):.4f}"
            )


def _error(pose: Any, first: Any, second: Any) -> tuple[float, float, float, float]:
    pitch = 0.5 * (first.pitch_px + second.pitch_px)
    return (
        pose.x - 0.5 * (first.x + second.x),
        pose.y - 0.5 * (first.y + second.y),
        pose.pitch / pitch - 1,
        0.5 * (first.distance_m + second.distance_m),
    )


if __name__ == "__main__":
    main()
