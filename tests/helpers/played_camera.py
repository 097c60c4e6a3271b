"""Camera backend that plays a film in real time, with configurable faults.

``camera:played:FILM`` has extra features: `Speed` in frames/s (0: unlimited), `Times` to play the film (0: endless),
frame numbers `Lost`, `Lost2` and `Broken`, `Unplugged` for the frame that loses the connection, `Back` for the number
of failed reconnections, and `Stamps` and `Numbers`, which 0 disables.
"""

import sys
import time
from collections.abc import Sequence
from pathlib import Path

from heliograph.base.frames import Frame
from heliograph.media import open_film
from heliograph.media.live.camera import CameraForm, CameraLostError, Found, Picture, register_camera
from heliograph.media.live.settings import CameraSettings

STEP_NS = 10_000_000
"""Default frame interval of the camera clock."""


class PlayedCamera:
    """Film playback; see `heliograph.media.live.camera.Camera`."""

    # cameras opened so far, failures to open left after a disconnection, and the frame at the last disconnection
    opened, unplugged = 0, 0
    pulled: int | None = None

    def __init__(self, address: str):
        self._path, self._next = address, 0
        self._frames: list[Frame] = []
        self._began_s: float | None = None

    def open(self, settings: CameraSettings) -> CameraForm:
        cls = type(self)
        if cls.unplugged:
            cls.unplugged -= 1
            raise CameraLostError("it does not answer")
        cls.opened += 1
        with open_film(Path(self._path)) as film:
            self._frames = list(film)
            form = CameraForm(film.width, film.height, film.bits, film.rate_hz, "Played", {"gain": "1"}, ())
        self._asked = {name: float(text) for name, text in settings.features.items()}
        self._period_ns = round(1e9 / form.rate_hz) if form.rate_hz else STEP_NS
        return form

    def frames(self, wait_s: float) -> Sequence[Picture] | None:
        if self._began_s is None:
            self._began_s = time.monotonic()
        speed, times = self._asked.get("Speed", 0.0), self._asked.get("Times", 1.0)
        last = len(self._frames) * int(times) if times else 1 << 60
        if self._next >= last:
            return None
        due = self._next + 8 if not speed else int((time.monotonic() - self._began_s) * speed)
        if due <= self._next:
            time.sleep(min(wait_s, 1 / speed))
            return []
        pictures: list[Picture] = []
        for number in range(self._next, min(due, last)):
            if number == self._asked.get("Unplugged") and type(self).pulled != number:
                if not pictures:
                    type(self).pulled, type(self).unplugged = number, int(self._asked.get("Back", 0))
                    raise CameraLostError("the cable was pulled")
                return pictures
            self._next = number + 1
            if number not in (self._asked.get("Lost"), self._asked.get("Lost2")):
                pictures.append(self._picture(number))
        return pictures

    def close(self) -> None:
        pass

    def _picture(self, number: int) -> Picture:
        if number == self._asked.get("Broken"):
            return Picture(None)
        stamp = 5_000_000_000 + number * self._period_ns if self._asked.get("Stamps", 1) else None
        frame = self._frames[number % len(self._frames)]
        return Picture(frame.pixels, number + 1 if self._asked.get("Numbers", 1) else None, stamp)


def find(_settings: CameraSettings) -> list[Found]:
    return [Found("FILM", "plays a film")]


# a command in this process may load this file again: tests change the first class
camera = getattr(sys.modules.get("played_camera"), "PlayedCamera", PlayedCamera)
camera.unplugged, camera.pulled = 0, None
register_camera("played", camera, find)
