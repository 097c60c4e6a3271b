"""What of a reading may be saved: frames of packets that failed, or the last ones, as a film that a page fetches."""

from pathlib import Path
from typing import Any

from heliograph.base.errors import HeliographError, MediaError
from heliograph.base.frames import Frame
from heliograph.receive import Packet
from heliograph.signal.settings import SignalSettings
from heliograph.web.bundles import Bundles
from heliograph.web.failures import Failures, Form

MOST_WRITTEN = 256 << 20
"""Most bytes of frames of a film that is saved: 40 s of 480 x 480 pixels at 30 frames a second. Chosen."""


class Saver:
    """Keeps frames while they are read; of the reader's thread, but `save` of any."""

    def __init__(self, folder: Path, bundles: Bundles):
        self._folder, self._bundles = folder, bundles
        self._failures: Failures | None = None
        self._signal: SignalSettings | None = None

    def begin(self, signal: SignalSettings) -> None:
        """Begin anew; what was kept goes."""
        self.close()
        self._signal = signal

    def expect(self, signal: SignalSettings) -> None:
        """Take another signal for that of the light; what is kept stays."""
        self._signal = signal
        if self._failures is not None:
            self._failures.expect(signal)

    def saw(self, frame: Frame) -> None:
        """Take a frame; nobody writes to its pixels any more."""
        if self._failures is None:
            assert self._signal is not None
            rows, columns = frame.pixels.shape
            form = Form(width=columns, height=rows, bits=frame.bits, rate_hz=None, signal=self._signal)
            self._failures = Failures(self._folder, form, MOST_WRITTEN)
        self._failures.saw(frame)

    def read(self, packet: Packet) -> None:
        """Keep the frames of a packet of which not all was read."""
        if packet.status != "ok" and self._failures is not None:
            self._failures.failed(packet)

    def save(self) -> dict[str, Any]:
        """Finish the film, and return by which name a page fetches it, and its bytes."""
        path = None if self._failures is None else self._failures.save()
        if path is None:
            raise MediaError("no frames were taken yet: start the camera")
        size = path.stat().st_size
        return {"bundle": self._bundles.add(path), "bytes": size}

    def offered(self) -> dict[str, Any] | None:
        """The same, where that cannot fail."""
        try:
            return self.save()
        except HeliographError:
            return None

    def close(self) -> None:
        """Throw away what was not saved."""
        if self._failures is not None:
            self._failures.close()
            self._failures = None
