"""The frames of packets that failed, kept as a film that `heliograph receive` opens again."""

import secrets
import threading
from collections import deque
from pathlib import Path

from heliograph.base.frames import Frame
from heliograph.link.notes import signal_note
from heliograph.media import FilmWriter, create_film
from heliograph.media.record import FASTEST_HZ
from heliograph.receive import Packet
from heliograph.web.watching.sources import Source

MOST_HELD = 256 << 20
"""Most bytes of frames that are held in memory. Chosen: 0.5 s of 1024 x 512 pixels at 1000 frames/s."""

MOST_WRITTEN = 1 << 30
"""Most bytes of frames in a film of what failed. Chosen; what fails after it is full is left out."""

BEFORE, AFTER = 1.2, 0.2
"""Packets' times kept before a packet that failed begins, so that its array is found and followed as it was, and after
its end. Chosen."""


class Failures:
    """Holds the last frames, and writes those about packets that failed; frames of one thread, saving in any.

    Parameters
    ----------
    folder
        Where the films go, under names of their own.
    source
        What is received: form of its frames, its signal and notes.

    Attributes
    ----------
    packets
        How many packets failed whose frames are in the film.
    full
        Whether the film takes no more.
    """

    def __init__(self, folder: Path, source: Source):
        self._folder, self._source, self._lock = folder, source, threading.Lock()
        size = source.width * source.height * (1 if source.bits == 8 else 2)
        self._size, self._most = size, max(2, MOST_HELD // size)
        self._frames: deque[Frame] = deque()
        self._film: FilmWriter | None = None
        self._until_s = self._last_s = float("-inf")
        self.packets, self.full = 0, False

    def saw(self, frame: Frame) -> None:
        """Take a frame; nobody writes to its pixels any more.

        Parameters
        ----------
        frame
            The next frame.
        """
        kept_s = (1 + BEFORE + AFTER) * self._source.signal.packet_s
        with self._lock:
            held = self._frames
            held.append(frame)
            while len(held) > self._most or held[0].time_s < frame.time_s - kept_s:
                held.popleft()
            if frame.time_s <= self._until_s:
                self._write(frame)

    def failed(self, packet: Packet) -> None:
        """Keep the frames of a packet.

        Parameters
        ----------
        packet
            One of which not all was read.
        """
        packet_s = self._source.signal.packet_s
        first_s = packet.start_time_s - BEFORE * packet_s
        with self._lock:
            if self.full:
                return
            self.packets += 1
            self._until_s = max(self._until_s, packet.start_time_s + (1 + AFTER) * packet_s)
            for frame in self._frames:
                if first_s <= frame.time_s <= self._until_s:
                    self._write(frame)

    def save(self) -> Path | None:
        """Finish the film of what failed, or of the last frames where nothing did; a new one begins with what follows.

        Returns
        -------
        The film; None where there are no frames.

        Raises
        ------
        MediaError
            It cannot be written.
        """
        with self._lock:
            if self._film is None:
                for frame in self._frames:
                    self._write(frame)
            film, self._film = self._film, None
            self.packets, self.full, self._last_s = 0, False, float("-inf")
            if film is None:
                return None
            film.finish()
            return film.path

    def close(self) -> None:
        """Throw away what was not saved."""
        with self._lock:
            self._frames.clear()
            if self._film is not None:
                self._film.abort()
                self._film = None

    def _write(self, frame: Frame) -> None:
        if frame.time_s <= self._last_s or self.full:
            return
        if self._film is None:
            source = self._source
            self._film = create_film(
                self._folder / f"{secrets.token_hex(16)}.h5",
                width=source.width,
                height=source.height,
                rate_hz=min(source.rate_hz, FASTEST_HZ),
                bits=source.bits,
                metadata={**source.metadata, **signal_note(source.signal)},
            )
        self._film.write(frame)
        self._last_s = frame.time_s
        self.full = self._film.frames_written * self._size >= MOST_WRITTEN
