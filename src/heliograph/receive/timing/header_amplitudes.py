"""What the frames around a header show of it: how much of the header, and how bright the array is."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from heliograph.base.arrays import RCOND, TINY, Floats
from heliograph.base.frames import Frame
from heliograph.receive.image.pose import Pose
from heliograph.receive.image.window import HALF_LIT, cut_out, window_around

CLIPPED = 0.02
"""Fraction of an array's pixels at full scale from which on its brightness is not used.

While 2 % of the pixels clip, each by no more than it shows, the brightness is wrong by 2 %: less than the 3 % by which
random data change it (`DEVIATION` of `light_clock`). Half and twice of it lose none of 192 codewords.
"""

MOVING_PX = 0.5
"""Motion in px from frame to frame at which the brightness counts half in power: what lies about an array moves past.

At 1.4 px a bright background changed it by a tenth of the light within a header; at rest random data do by 3 %.
"""

SURROUNDINGS_PX = 3.0
"""Pixels around the array against which its brightness is measured: five times the blur of the reference link."""


@dataclass(frozen=True, slots=True)
class HeaderAmplitudes:
    """What the frames around a header show."""

    # (frames,) starts of the exposures in seconds
    times_s: Floats
    # (frames,) amplitude of the header in gray levels, negative for its inverse
    alternation: Floats
    # (frames,) light of the array in gray levels, but for a constant
    brightness: Floats
    # Whether pixels were at full scale; the brightness is then not used
    clipped: bool = False
    # Weight of the brightness, 0 to 1: less where the array moves
    trust: float = 1.0


def header_amplitudes(frames: list[Frame], poses: list[Pose], lit: Floats) -> HeaderAmplitudes:
    """Measure what the frames around a header show."""
    seen = [_seen(frame, pose, lit) for frame, pose in zip(frames, poses, strict=True)]
    gram, matched = np.array([one.gram for one in seen]), np.array([one.matched for one in seen])
    # where only lit LEDs or only dark ones are left, the two images are one: the pseudo-inverse decides
    header = np.einsum("fi,fi->f", np.linalg.pinv(gram, RCOND, hermitian=True)[:, 0], matched)
    # of the background, which may move, only what blur mixes in counts
    light = (matched[:, 1] - header * gram[:, 0, 1]) / np.maximum(gram[:, 1, 1], TINY)
    places = np.array([(pose.x, pose.y) for pose in poses])
    moved = float(np.median(np.hypot(*np.diff(places, axis=0).T))) if len(poses) > 1 else 0.0
    return HeaderAmplitudes(
        np.array([f.time_s for f in frames]),
        header,
        light,
        max(one.clipped for one in seen) > CLIPPED,
        1 / float(np.hypot(1, moved / MOVING_PX)),
    )


class _Seen(NamedTuple):
    """Inner products (3, 3) of images of the header, of the array all on and of an even background.

    Those with a frame's pixels, (3,), and the fraction of the array's pixels that clip.
    """

    gram: Floats
    matched: Floats
    clipped: float


def _seen(frame: Frame, pose: Pose, lit: Floats) -> _Seen:
    """What a frame shows of the array."""
    from heliograph.receive.image.footprint import images_of  # Numba is slow to import

    window = window_around(pose, len(lit), SURROUNDINGS_PX)
    x0, y0, width, height = window
    pixels = cut_out(frame, window).ravel()
    on, off = images_of(np.abs(lit), lit < 0, 2, pose, (x0, y0), (height, width)).reshape(2, -1)
    columns = np.stack([on - off, on + off, np.ones(pixels.size)])
    full, all_on, clipped = pixels >= frame.full_scale, columns[1], 0.0
    if full.any():
        clipped = float(full[all_on >= HALF_LIT * all_on.max()].mean())
    return _Seen(columns @ columns.T, columns @ pixels, clipped)
