"""Frames read ahead of their use, in a thread of their own: decoders do not hold Python's lock."""

import queue
import threading
from collections.abc import Iterator

from heliograph.base.frames import Frame

FRAMES_AHEAD = 8
"""Frames that wait for their use at most; bounds memory. Chosen, as for films that are written: a receiver that stops
for 50 ms, looking for an array, then goes on with frames of FFV1 that were decoded meanwhile."""


def read_ahead(frames: Iterator[Frame]) -> Iterator[Frame]:
    """Yield frames in their order while the next ones are read.

    The thread begins with the first frame that is asked for. It ends with the frames, or where no more are asked for:
    by an error, by Ctrl-C, or when the iterator is closed. It is then waited for, so that the film's file is closed.
    """
    waiting: queue.Queue[Frame | BaseException | None] = queue.Queue(FRAMES_AHEAD)
    wanted = threading.Event()
    wanted.set()
    thread = threading.Thread(target=_read, args=(frames, waiting, wanted), name="film-reader", daemon=True)
    thread.start()
    ended = False
    try:
        while True:
            got = waiting.get()
            if not isinstance(got, Frame):
                ended = True
                if got is not None:
                    raise got
                return
            yield got
    finally:
        wanted.clear()
        while not ended:  # the thread may wait for room
            ended = not isinstance(waiting.get(), Frame)
        thread.join()


def _read(
    frames: Iterator[Frame], waiting: "queue.Queue[Frame | BaseException | None]", wanted: threading.Event
) -> None:  # fmt: skip
    """Put frames in the queue while they are wanted, and last of all the error that ended them, or None."""
    end: BaseException | None = None
    try:
        for frame in frames:
            waiting.put(frame)
            if not wanted.is_set():
                break
        close = getattr(frames, "close", None)
        if close is not None:
            close()
    except BaseException as error:  # raised in the thread that asks for the frames, which waits for an end
        end = error
    waiting.put(end)
