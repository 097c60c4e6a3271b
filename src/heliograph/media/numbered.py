"""What recordings have in common whose frames have numbers, and no times of their own."""

from abc import abstractmethod
from collections.abc import Iterable, Iterator
from pathlib import Path

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame, Pixels
from heliograph.media.reader import FilmReader, checked_time


class NumberedReader(FilmReader):
    """A recording whose frame of number k is taken at ``k / rate_hz``; see `FilmReader`."""

    def _frames(self) -> Iterator[Frame]:
        count = 0
        for number, pixels in self._pictures():
            time_s = checked_time(self.path, number / self.rate_hz, count)
            yield Frame(number, time_s, pixels, self.bits)
            count += 1
        if not count:
            raise MediaError(f"{self.path} holds no frames: record it again")

    @abstractmethod
    def _pictures(self) -> Iterator[tuple[int, Pixels]]:
        """Yield each frame's number, rising from 0, and its gray levels."""


def camera_rate(path: Path, rate_hz: float | None, said_hz: float | None = None) -> float:
    """Return the frames per second that a file says, else those that were asked for."""
    rate = said_hz or rate_hz
    if not rate:
        raise MediaError(
            f"{path} has no clock: say how many frames a second the camera took, by --fps (rate_hz; on page Watch "
            "Frames/s)"
        )
    return rate


def expected_frames(path: Path, claimed: int, frame_bytes: int) -> int:
    """Return how many frames are to be expected of a file: those it claims, but no more than it has room for."""
    return min(claimed, path.stat().st_size // frame_bytes)


def blocks(path: Path, places: Iterable[int], size: int) -> Iterator[bytearray]:
    """Yield the bytes of each frame of a file in a writable array, for which the kernels are compiled."""
    try:
        with path.open("rb") as file:
            length = path.stat().st_size
            for count, place in enumerate(places):
                if place + size > length:  # before memory is taken for it
                    raise MediaError(f"{path} ends in the middle, after {count} whole frames: copy it again")
                file.seek(place)
                block = bytearray(size)
                if file.readinto(block) < size:
                    raise MediaError(f"{path} became shorter, after {count} whole frames: copy it again")
                yield block
    except MediaError:
        raise
    except OSError as error:
        raise MediaError(f"cannot read {path}: {error.strerror}") from error
