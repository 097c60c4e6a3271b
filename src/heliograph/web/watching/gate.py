"""Flow control of a watched reception: pause, single steps, and speed."""

import threading
import time


class Gate:
    """Gate before each frame; the thread of the reception waits, the event loop controls."""

    def __init__(self, speed: float | None = None):
        self.paused, self.stopped = False, False
        self._speed, self._frames, self._to_packet = speed, 0, False
        self._anchor: tuple[float, float] | None = None
        self._changed = threading.Condition()

    def pause(self) -> None:
        """Hold the next frame."""
        self._set(paused=True)

    def go(self) -> None:
        """Pass all frames."""
        self._set(paused=False)

    def step(self, to_packet: bool = False) -> None:
        """Pass one frame, or all frames up to the end of a packet; then hold the next frame."""
        self._set(paused=True, frames=0 if to_packet else 1, to_packet=to_packet)

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

    def packet_read(self) -> None:
        """End a step to the end of a packet."""
        with self._changed:
            self._to_packet = False

    @property
    def holds(self) -> bool:
        """True if the gate holds the next frame."""
        with self._changed:
            return self._is_closed()

    def pass_through(self, time_s: float) -> bool:
        """Wait until a frame may pass; return False after `stop`."""
        with self._changed:
            while not self.stopped:
                if self._is_closed():
                    self._anchor = None
                    self._changed.wait()
                    continue
                if self._frames:
                    self._frames -= 1
                    return True
                wait_s = self._wait_s(time_s)
                if wait_s <= 0:
                    return True
                self._changed.wait(wait_s)
            return False

    def _is_closed(self) -> bool:
        return self.paused and not self._frames and not self._to_packet

    def _wait_s(self, time_s: float) -> float:
        """Return the time in s until a frame is due at the present speed."""
        now = time.monotonic()
        if self._speed is None:
            return 0.0
        if self._anchor is None:
            self._anchor = now, time_s
        start_s, first_s = self._anchor
        wait_s = start_s + (time_s - first_s) / self._speed - now
        if wait_s < -1.0:  # a slow receiver does not catch up
            self._anchor = now, time_s
        return wait_s

    def _set(self, paused: bool, frames: int = 0, to_packet: bool = False) -> None:
        with self._changed:
            self.paused, self._frames, self._to_packet, self._anchor = paused, frames, to_packet, None
            self._changed.notify_all()
