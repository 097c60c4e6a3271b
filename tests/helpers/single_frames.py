"""Single frames with an array on a dark panel before a bright background, rendered from the equations."""

import numpy as np
from numpy.typing import NDArray
from scenes import draw, frame_of, pitch_at
from scipy.special import erf

from heliograph.base.frames import Frame
from heliograph.receive import Pose
from heliograph.receive.equalise.single_mode import HeaderPair
from heliograph.receive.sync.pairing import FramePair
from heliograph.signal import haar
from heliograph.signal.header import header_levels
from heliograph.signal.polarity import balance
from heliograph.signal.pwm import lit_slots

Floats = NDArray[np.float64]

GAIN = 0.8 * 255
PANEL = 9.0
"""Half side of the panel in pitches; the blur of the outer LEDs reaches the rim."""


def framed(
    pose: Pose, levels: Floats, index: int, rng: np.random.Generator, motion: tuple[float, float] = (0.0, 0.0)
) -> Frame:
    """Render a frame with LED levels 0 to 4, centred at a pose; `motion` is px during the pattern exposure."""
    light = np.zeros((80, 80))
    # each slot covers a quarter of the motion
    slots = lit_slots(levels.astype(np.uint8)) if any(motion) else levels[None] / 4.0
    for k, lit in enumerate(slots):
        part = (k + 0.5) / len(slots) - 0.5
        at = pose.moved(part * motion[0], part * motion[1])
        edge, grid = PANEL * at.pitch, np.arange(80)
        across, down = (0.5 * (erf((edge - abs(grid - c)) / 0.75) + 1) for c in (at.x, at.y))
        shown = 0.45 - 0.43 * down[:, None] * across
        # slots have equal length, hence equal weights
        light += (shown + 0.8 * draw(at, lit.astype(float), (0, 0), light.shape)) / len(slots)
    return frame_of(light, index, rng)


def headers() -> list[HeaderPair]:
    """Return the two header pairs for identity 7 at 80 m."""
    rng, levels = np.random.default_rng(0), header_levels(7).astype(float)
    pose = Pose(40.2, 39.7, pitch_at(80.0), 0.01, 0.53)
    found = []
    for k in (0, 2):
        up, down = framed(pose, levels, k, rng), framed(pose, 4 - levels, k + 1, rng)
        found.append((FramePair(up, down), (pose, pose)))
    return found


def patterns(count: int, seed: int) -> list[Floats]:
    """Draw levels for random data in single mode."""
    rng = np.random.default_rng(seed)
    d = rng.choice(np.array([-1, 1], np.int8), (count, 16, 16))
    d[:, :8, :8] = balance(d[:, :8, 1:8])
    return [one.astype(float) for one in haar.encode(d)]
