"""Frames and their truth straight from the channel, in place of a film and its truth file."""

from collections import deque
from collections.abc import Iterator, Sequence
from itertools import islice

import numpy as np

from heliograph.base.frames import Frame
from heliograph.channel import Truth
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Messages, Recordings, simulate
from heliograph.link.truth import FrameTruth


class LiveFilm:
    """Frames as they are rendered, and the truth of each frame.

    It is a `FrameSource` and a `TruthSource`. Frames are taken once, in the order of time.
    """

    path = "the film"

    def __init__(
        self,
        settings: LinkSettings,
        messages: Sequence[Messages],
        seed: int,
        recordings: Recordings | None,
        margin_px: int | None,
    ):
        self.settings = settings
        self.messages = messages
        self._rendered = simulate(settings, messages, seed, recordings, margin_px)
        # Windows rendered before the first of them is taken. Chosen: channel and receiver by turns, frame by frame,
        # take 15 % more time of both, as each finds the processor's caches full of the other; at half and at twice the
        # value it is the same
        self._ahead = 1 if margin_px is None else 64
        self._truths: deque[FrameTruth] = deque()

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames; the truth of a frame is there before the frame is."""
        while rendered := list(islice(self._rendered, self._ahead)):
            self._truths.extend(_counted_truth(truth) for _, truth in rendered)
            yield from (frame for frame, _ in rendered)

    def frames(self) -> Iterator[FrameTruth]:
        """Yield the truth of each frame, in the order of time; to be asked once for each frame that was taken."""
        while True:
            yield self._truths.popleft()


def _counted_truth(truth: Truth) -> FrameTruth:
    # a truth file has distances in single precision
    distances = [float(np.float32(array.distance_m)) for array in truth.arrays]
    return FrameTruth(truth.index, truth.time_s, distances, [array.visible for array in truth.arrays])
