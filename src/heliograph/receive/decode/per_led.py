"""Packets by luminances at the LEDs, as the paper reads them: FHWT, and one decoding.

Luminances are samples of a pair, pattern minus inverse, or least squares with the blur of all LEDs known.

With the pose and the blur known, the difference of pattern and inverse is A (2 x - 1), A being the blur matrix. The
image of an LED is a product of a function of x and a function of y, so A^T A is the elementwise product of two small
Gram matrices, and A is never made.
"""

from collections.abc import Callable
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.decode.codeword import Decoding, decode_packet
from heliograph.receive.decode.combining import SoftBuffer
from heliograph.receive.decode.header_reader import HeaderReader
from heliograph.receive.decode.worker import Decoded
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.equalise.single_mode import DecisionDirectedTracker
from heliograph.receive.events import ExtractEvent, Observer
from heliograph.receive.geometry import kernels
from heliograph.receive.geometry.footprint import footprints, image_of, to_grid
from heliograph.receive.geometry.pose import Corner, Pose
from heliograph.receive.geometry.window import AnyFrame, cut_out, window_around
from heliograph.receive.observe.cutout import Cutouts
from heliograph.receive.packet import Words
from heliograph.receive.settings import Equaliser
from heliograph.receive.sync.pairing import FramePair
from heliograph.receive.track.track import Track, TrackedPair
from heliograph.signal.formats import AGREED
from heliograph.signal.packet import PacketFormat


def unblurred(
    frames: tuple[AnyFrame, AnyFrame], poses: tuple[Pose, Pose], gain: float, side: int, loading: float = 1e-4
) -> Floats:
    """Normalised luminances x' = level - 2 of a pair, deblurred.

    With A_1 and A_2 at the poses of the two frames, the background equal in both and s = 2 x - 1:

        d = (r - r_inverted) / gain = A_1 x - A_2 (1 - x) = M s + (A_1 - A_2) 1 / 2,  M = (A_1 + A_2) / 2
        s = (M^T M + lambda I)^-1 M^T (d - (A_1 - A_2) 1 / 2)

    M is A at the middle pose, the blur wider by the motion: sigma^2 + (half the motion)^2. The loading lambda is about
    noise / light, the image of a wide array with all LEDs on being 1.
    """
    middle = Pose.midway(*poses)
    motion = 0.5 * (poses[1].x - poses[0].x), 0.5 * (poses[1].y - poses[0].y)
    window = window_around(middle, side, 2.5 + max(abs(motion[0]), abs(motion[1])))  # px that LEDs at the rim light
    corner, shape = (window[0], window[1]), (window[3], window[2])
    change = (cut_out(frames[0], window) - cut_out(frames[1], window)) / max(gain, TINY)
    ones = np.ones((side, side))
    change -= 0.5 * (image_of(ones, poses[0], corner, shape) - image_of(ones, poses[1], corner, shape))
    across, down = footprints(middle, corner, shape, side, motion)
    # M^T M: <led_i, led_j> = <across_i, across_j> <down_i, down_j>
    gram = (across @ across.T) * (down @ down.T) + loading * np.eye(side * side)
    _, s, _ = lapack.dposv(gram, np.einsum("kj,kj->k", down @ change, across), overwrite_a=1)
    return 2 * to_grid(s)


def pair_luminances(
    frames: tuple[AnyFrame, AnyFrame], poses: tuple[Pose, Pose], gain: float, side: int, equaliser: Equaliser
) -> Floats:
    """Normalised luminances x' = level - 2 of a data pair."""
    if equaliser == "inverse":
        return unblurred(frames, poses, gain, side)
    up, down = (at_leds(frame.pixels, frame.origin, pose, side) for frame, pose in zip(frames, poses, strict=True))
    return normalised(up - down, gain)


def normalised(change: NDArray[np.float64], gain: float) -> NDArray[np.float64]:
    """Normalised luminances x' = level - 2 by samples of a pattern less the inverse."""
    # r - r_inverted = gain (x - (1 - x)) = gain (2 x - 1) = gain x' / 2
    return 2 * change / max(gain, TINY)


def at_leds(pixels: NDArray[Any], corner: Corner, pose: Pose, side: int) -> NDArray[np.float64]:
    """Value of an image at each LED's position, by cubic interpolation."""
    out = np.empty((side, side))
    kernels.cubic_at_leds(pixels, pose.x - corner[0], pose.y - corner[1], pose.axes, out)
    return out


def decode_per_led(cutouts: Cutouts, form: PacketFormat, identity: int, options: Decoding) -> Words | None:
    """Decode samples at the LEDs, as the paper does: no blur, neighbour or hidden LED need be known."""
    present = [cutout for cutout in cutouts if cutout is not None]
    if form.single or not present or any(cutout.combination is not None for cutout in present):
        return None
    seen = np.array([cutout is not None for cutout in cutouts])
    return decode_packet(sample_differences(cutouts, form.settings.side), seen, form, identity, options)


def sample_differences(cutouts: Cutouts, side: int) -> Floats:
    """Difference of each pair at the LEDs, (pairs, n, n); 0 for missing pairs."""
    out = np.zeros((len(cutouts), side, side))
    for place, cutout in enumerate(cutouts):
        if cutout is not None:
            out[place] = at_leds(cutout.difference, cutout.corner, cutout.middle, side)
    return out


# reads luminances (n, n) of two frames, by the poses in both and the gain
ReadPair = Callable[[tuple[AnyFrame, AnyFrame], tuple[Pose, Pose], float], Floats]


class PlainPacket:
    """Observations of a packet by the plain receiver; see `worker.PacketObservations`."""

    cutouts = ()

    def __init__(self, identity: int, form: PacketFormat, read: ReadPair, options: Decoding):
        self.form, self.mode = form, AGREED.number
        self._identity, self._read, self._options = identity, read, options
        pairs, side = form.settings.data_pairs, form.settings.side
        # difference of pattern and inverse at each LED, and True for visible pairs
        self._luminances, self._seen = np.zeros((pairs, side, side)), np.zeros(pairs, dtype=bool)

    def __getstate__(self) -> dict[str, Any]:
        # another process only decodes
        return {**self.__dict__, "_read": None}

    def add_pair(self, place: int, pair: FramePair, tracked: TrackedPair) -> ExtractEvent:
        """Read the luminances of a pair; see `PacketObservations`."""
        frames, state = (pair.pattern, pair.inverted), tracked.state
        poses = state.pose_at(pair.pattern.time_s), state.pose_at(pair.inverted.time_s)
        x = self._read(frames, poses, tracked.track.gain)
        self._luminances[place], self._seen[place] = x, True
        return ExtractEvent(self._identity, frames, poses, x)

    def end(self, headers: HeaderReader, track: Track, decisions: DecisionDirectedTracker | None) -> None:  # noqa: ARG002 - the protocol's
        """Take the mode from the header; see `PacketObservations`."""
        self.mode = headers.mode(track.data_gain)

    def has_codeword(self) -> bool:
        """Return False: no check is faster than decoding; see `PacketObservations`."""
        return False

    def renumbered(self, place: int) -> "PlainPacket":
        """Return the packet with a lost pair; see `PacketObservations`."""
        moved = copy(self)
        moved._luminances = np.insert(self._luminances, place, 0.0, axis=0)[:-1]
        moved._seen = np.insert(self._seen, place, False)[:-1]
        return moved

    def decode(self, led_gains: LedGains | None, buffer: SoftBuffer | None, observe: Observer, /) -> Decoded:  # noqa: ARG002 - the protocol's
        """Decode the luminances; see `PacketObservations`."""
        words = decode_packet(self._luminances, self._seen, self.form, self._identity, self._options)
        return Decoded(words, luminances=self._luminances)
