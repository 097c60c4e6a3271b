"""Read animated pictures: GIF, PNG and WebP with a time for each picture."""

import statistics
import struct
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from heliograph.base.errors import MediaError, brief
from heliograph.base.frames import Frame, Pixels
from heliograph.media import pictures
from heliograph.media.reader import FilmReader, checked_size, checked_time
from heliograph.media.reading import Reading

if TYPE_CHECKING:
    from PIL.Image import Image

ANIMATED = ("GIF", "PNG", "WEBP")
"""Kinds of pictures that can be animated, under Pillow's names."""

SIGNATURES = (b"GIF8", b"\x89PNG\r\n\x1a\n", b"RIFF")
"""First bytes of such files; those that begin with RIFF may be films."""

_DEFAULT_S = 0.1
"""Time of a picture that states none, as browsers show it."""

_FRAMES_TIMED = 100
"""Pictures whose times tell the rate. Chosen: the times of later ones are read while they are decoded."""

_BROKEN = (OSError, SyntaxError, ValueError, EOFError, struct.error, IndexError, KeyError, TypeError)
"""Errors of Pillow on damaged files."""


class AnimationReader(FilmReader):
    """An animated picture; see `FilmReader`. Times are the sums of the times for which the pictures are shown."""

    _decodes = True
    faster = ("HDF5",)

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading.rate_hz)
        self._channel = reading.channel
        shown = [seconds for _, seconds in islice(self._decoded(), _FRAMES_TIMED)]
        self.claimed_hz = 1 / statistics.median(shown)
        with _opened(path) as image:
            self.width, self.height = image.size
            self.frame_count = getattr(image, "n_frames", 1)
        first, _ = next(self._decoded())
        self.bits = 8 * first.itemsize
        self.metadata = {}

    def _frames(self) -> Iterator[Frame]:
        index, time_s = -1, 0.0
        for count, (pixels, delay_s) in enumerate(self._decoded()):
            index = max(index + 1, round(checked_time(self.path, time_s, count) * self.rate_hz))
            yield Frame(index, time_s, pixels, self.bits)
            time_s += 1 / self._true_hz if self._true_hz else delay_s

    def _decoded(self) -> Iterator[tuple[Pixels, float]]:
        """Yield the gray levels of each picture and the time in s for which it is shown."""
        count = 0
        try:
            with _opened(self.path) as image:
                for count in range(getattr(image, "n_frames", 1)):
                    image.seek(count)
                    image.load()
                    yield _levels(image, self._channel), float(image.info.get("duration") or 0) / 1e3 or _DEFAULT_S
        except MediaError:
            raise
        except _BROKEN as error:
            raise MediaError(
                f"{self.path} cannot be read after {count} whole frames ({brief(error)}): copy it again"
            ) from None


def is_animation(path: Path, head: bytes) -> bool:
    """Return True if a file is a GIF, or a PNG or WebP file of several pictures."""
    if not head.startswith(SIGNATURES) or (head.startswith(b"RIFF") and path.suffix.lower() != ".webp"):
        return False
    try:
        with _opened(path) as image:
            return image.format == "GIF" or getattr(image, "n_frames", 1) > 1
    except (MediaError, *_BROKEN):
        return False


def _opened(path: Path) -> "Image":
    from PIL import Image

    try:
        image = Image.open(path, formats=ANIMATED)
    except Image.DecompressionBombError:
        raise MediaError(f"{path} claims more pixels than any camera has: it is no film, or damaged") from None
    except _BROKEN as error:
        raise MediaError(f"{path} cannot be read as an animated picture ({brief(error)}): copy it again") from None
    checked_size(path, *image.size)
    return image


def _levels(image: "Image", channel: str) -> Pixels:
    if image.mode == "L" or image.mode.startswith("I;16"):
        levels = np.array(image)
        return pictures.to_gray(levels.astype(levels.dtype.newbyteorder("=")), channel)
    return pictures.to_gray(np.array(image.convert("RGB"))[..., ::-1], channel)
