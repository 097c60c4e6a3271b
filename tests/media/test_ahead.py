"""Read frames ahead: in order, bounded, cleanly ended."""

import threading
import time
from collections.abc import Generator
from pathlib import Path

import numpy as np
import pytest
from film_checks import uniform, write_levels
from waiting import wait_until

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.media import open_film
from heliograph.media.reader import read_ahead


class Source:
    """Frame source that records the number of frames made, and closing."""

    def __init__(self, count: int, error: Exception | None = None) -> None:
        self.made, self.closed, self._count, self._error = 0, False, count, error

    def frames(self) -> Generator[Frame, None, None]:
        try:
            for number in range(self._count):
                self.made += 1
                yield Frame(number, number / 1000, np.zeros((2, 2), np.uint8))
            if self._error is not None:
                raise self._error
        finally:
            self.closed = True


def readers() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name.startswith("film-reader")]


def test_frames_keep_their_order_and_reading_starts_with_the_first_request() -> None:
    source = Source(100)
    frames = read_ahead(source.frames())
    assert source.made == 0
    assert not readers()
    assert [frame.index for frame in frames] == list(range(100))
    assert source.closed
    assert not readers()


def test_at_most_ten_frames_are_read_ahead() -> None:
    source = Source(100)
    frames = read_ahead(source.frames())
    assert next(frames).index == 0
    wait_until(lambda: source.made >= 10)
    time.sleep(0.05)
    assert source.made == 10  # eight queued frames, a frame in use, and a frame at the full queue
    frames.close()
    assert source.closed
    assert source.made < 100
    assert not readers()


def test_an_error_comes_after_the_frames_before_it() -> None:
    source, got = Source(20, MediaError("torn")), list[Frame]()
    with pytest.raises(MediaError, match="torn"):
        got.extend(read_ahead(source.frames()))
    assert len(got) == 20
    assert source.closed
    assert not readers()


def test_ctrl_c_ends_the_thread() -> None:
    source = Source(10_000)

    def use() -> None:
        for frame in read_ahead(source.frames()):
            if frame.index == 5:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        use()
    assert source.closed
    assert source.made < 10_000
    assert not readers()


@pytest.mark.parametrize("suffix", [".mkv", ".h5"])
def test_a_film_left_early_is_read_again_and_closed(tmp_path: Path, suffix: str) -> None:
    with open_film(write_levels(tmp_path / f"a{suffix}", uniform(range(60), 32, 48))) as read:
        next(iter(read))
        assert [frame.index for frame in read] == list(range(60))
        next(iter(read))
    assert not readers()
