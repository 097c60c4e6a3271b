"""Pause, step and speed of a reception: a gate before each of its frames."""

import threading
import time


class Gate:
    """Lets frames through: all, one, those up to a packet's end, or in time; one thread waits, another says so."""

    def __init__(self, speed: float | None = None):
        self.paused, self.stopped = False, False
        self._speed, self._frames, self._to_packet = speed, 0, False
        self._anchor: tuple[float, float] | None = None
        self._changed = threading.Condition()

    def pause(self) -> None:
        """Hold the next frame."""
        self._set(paused=True)

    def go(self) -> None:
        """Let all frames through."""
        self._set(paused=False)

    def step(self, to_packet: bool = False) -> None:
        """Let one frame through, or all until a packet is read; then hold the next one."""
        self._set(paused=True, frames=0 if to_packet else 1, to_packet=to_packet)

    def run_at(self, speed: float | None) -> None:
        """Change the speed."""
        with self._changed:
            self._speed, self._anchor = speed, None
            self._changed.notify_all()

    def stop(self) -> None:
        """Let no more frames through."""
        with self._changed:
            self.stopped = True
            self._changed.notify_all()

    def packet_read(self) -> None:
        """A packet is read: steps up to it are done."""
        with self._changed:
            self._to_packet = False

    @property
    def holds(self) -> bool:
        """Whether the next frame would be held."""
        with self._changed:
            return self.paused and not self._frames and not self._to_packet

    def pass_through(self, time_s: float) -> bool:
        """Wait until a frame may be taken; False where there are to be no more."""
        with self._changed:
            while not self.stopped:
                if self.paused and not self._frames and not self._to_packet:
                    self._anchor = None
                    self._changed.wait()
                    continue
                if self._frames:
                    self._frames -= 1
                    return True
                wait_s = self._early_s(time_s)
                if wait_s <= 0:
                    return True
                self._changed.wait(wait_s)
            return False

    def _early_s(self, time_s: float) -> float:
        """Seconds until a frame is due by the speed."""
        now = time.monotonic()
        if self._speed is None:
            return 0.0
        if self._anchor is None:
            self._anchor = now, time_s
        began, first_s = self._anchor
        early = began + (time_s - first_s) / self._speed - now
        if early < -1.0:  # the receiver is behind: it does not run after lost time
            self._anchor = now, time_s
        return early

    def _set(self, paused: bool, frames: int = 0, to_packet: bool = False) -> None:
        with self._changed:
            self.paused, self._frames, self._to_packet, self._anchor = paused, frames, to_packet, None
            self._changed.notify_all()
