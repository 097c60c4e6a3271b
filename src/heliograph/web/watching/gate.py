"""Flow control of a watched reception: pause, single steps, and speed."""

import threading
import time
from math import inf


class Gate:
    """Gate before each frame; the thread of the reception waits, the event loop controls."""

    def __init__(self, speed: float | None = None):
        self.stopped = False
        self._allowed, self._is_packet_step = inf, False
        self._speed = speed
        self._anchor: tuple[float, float] | None = None
        self._changed = threading.Condition()

    def allow(self, frames: float, *, until_packet: bool = False) -> None:
        """Pass a number of frames, or all frames up to the end of a packet; then hold the next frame."""
        with self._changed:
            self._allowed, self._is_packet_step, self._anchor = frames, until_packet, None
            self._changed.notify_all()

    def run_at(self, speed: float | None) -> None:
        """Change the speed as a multiple of real time; None for full speed."""
        with self._changed:
            self._speed, self._anchor = speed, None
            self._changed.notify_all()

    def stop(self) -> None:
        """Pass no more frames."""
        with self._changed:
            self.stopped = True
            self._changed.notify_all()

    def end_packet(self) -> None:
        """End a step to the end of a packet."""
        with self._changed:
            if self._is_packet_step:
                self._allowed = 0

    @property
    def paused(self) -> bool:
        """True while paused, or during a step."""
        return self._allowed < inf or self._is_packet_step

    @property
    def holds(self) -> bool:
        """True if the gate holds the next frame."""
        return not self._allowed

    def pass_through(self, time_s: float) -> bool:
        """Wait until a frame may pass; return False after `stop`."""
        with self._changed:
            while not self.stopped:
                if not self._allowed:
                    self._anchor = None
                    self._changed.wait()
                elif self._allowed < inf:
                    self._allowed -= 1
                    return True
                elif (wait_s := self._wait_s(time_s)) > 0:
                    self._changed.wait(wait_s)
                else:
                    return True
            return False

    def _wait_s(self, time_s: float) -> float:
        """Return the time in s until a frame is due at the present speed."""
        if self._speed is None:
            return 0.0
        now = time.monotonic()
        start_s, first_s = self._anchor = self._anchor or (now, time_s)
        wait_s = start_s + (time_s - first_s) / self._speed - now
        if wait_s < -1.0:  # a slow receiver does not catch up
            self._anchor = now, time_s
        return wait_s
