"""A reception in a thread of its own: it takes frames through a gate, and tells what happens."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.measure.errors import ErrorCounter
from heliograph.measure.journal import Journal, Row
from heliograph.measure.live_film import LiveFilm
from heliograph.measure.reception import Reception, receive_film
from heliograph.measure.statistics import clopper_pearson
from heliograph.media.live.reader import LiveReader
from heliograph.signal.settings import LAYERS
from heliograph.web.failures import Failures, Form
from heliograph.web.shared import Shared
from heliograph.web.watching.gate import Gate
from heliograph.web.watching.scene import Scene, Seen
from heliograph.web.watching.sources import Asked, Source, opened
from heliograph.web.watching.stages import SEARCH, Stages

SCENE_S = 1 / 30
"""Least time in s from one scene to the next: a screen shows few more."""


@dataclass(frozen=True, slots=True)
class Teller:
    """Who hears of a reception; called in its thread."""

    # Gets rows of plain values, all of them in order
    tell: Callable[[Row], None]
    # Gets scenes, of which only the newest counts
    show: Callable[[Scene], None]
    # Gets the exception that ended the reception
    fail: Callable[[BaseException], None]


class Run:
    """A reception that is watched."""

    def __init__(self, asked: Asked, shared: Shared, teller: Teller, gate: Gate):
        self._asked, self._shared, self._teller, self.gate = asked, shared, teller, gate
        self.failures: Failures | None = None
        self._stages = Stages()
        self._newest: Frame | None = None
        self._live: LiveReader | None = None
        self._began = self._counted = time.monotonic()
        self._shown = float("-inf")  # the first frame is shown at once
        self._ending, self._over, self._abandoned = threading.Lock(), False, False
        self._thread = threading.Thread(target=self._main, name="watch", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def abandon(self) -> None:
        """End it before its next frame, and throw away what was not saved, without waiting for that."""
        self._let_go()
        with self._ending:
            self._abandoned = True
            if self._over and self.failures is not None:
                self.failures.close()

    def stop(self) -> None:
        """The same, and wait for it."""
        self.abandon()
        self._thread.join()

    def halt(self) -> None:
        """End it before its next frame, and wait for that; what failed may still be saved."""
        self._let_go()
        self._thread.join()

    @property
    def is_over(self) -> bool:
        """Whether it has ended by itself or was halted."""
        return self._over

    def _let_go(self) -> None:
        self.gate.stop()
        if self._live is not None:
            self._live.stop()  # it may be waiting for a frame that never comes

    def save(self) -> Path | None:
        """Film of what failed so far, see `Failures.save`."""
        return None if self.failures is None else self.failures.save()

    def _main(self) -> None:
        try:
            self._watch()
        except BaseException as error:  # nothing above would tell the page; the server goes on
            self._teller.fail(error)

    def _watch(self) -> None:
        try:
            with opened(self._asked, self._shared) as source:
                self._receive(source)
        finally:
            with self._ending:
                self._over = True
                if self._abandoned and self.failures is not None:
                    self.failures.close()

    def _receive(self, source: Source) -> None:
        tell = self._teller.tell
        tell(_about(source))
        self._live = source.live
        _attend(source, tell)
        self.failures = Failures(self._shared.uploads.folder(), _form(source))
        calibration = source.settings.receive.calibration
        seen, reception = Seen(source.signal, calibration), Reception(source.truth)
        try:
            self._read(source, seen, reception, Journal(calibration, tell))
        finally:
            if self._newest is not None:
                self._teller.show(seen.scene(self._newest))
            tell(self._counts(reception))
        tell({"event": "end", "stopped": self.gate.stopped})

    def _read(self, source: Source, seen: Seen, reception: Reception, journal: Journal) -> None:
        """Receive the film, and tell what happens."""

        def observe(event: Any) -> None:
            self._stages.event(event)
            seen(event)
            journal.observe(event)
            self._stages.mark("show")

        film = _Film(source, lambda: self._frames(source, seen, reception))
        for packet, messages in receive_film(film, source.signal, source.settings, reception, observe):
            self._stages.mark(SEARCH)
            for row in seen.packets():
                self._teller.tell(row)
            journal.read(packet, messages, reception.progress)
            self._teller.tell({"event": "unfinished", "messages": _unfinished(reception)})
            if packet.status != "ok" and self.failures is not None:
                self.failures.failed(packet)
            self.gate.packet_read()
            self._stages.mark("show")

    def _frames(self, source: Source, seen: Seen, reception: Reception) -> Iterator[Frame]:
        """Frames as the gate lets them through, shown after they were received."""
        frames = iter(source.frames)
        self._stages.mark("show")
        for frame in frames:
            self._stages.mark("render" if isinstance(source.frames, LiveFilm) else "read")
            self._show(seen, reception)
            self._stages.mark("show")
            if not self.gate.pass_through(frame.time_s):
                break
            self._stages.mark("wait")
            if self.failures is not None:
                self.failures.saw(frame)
            self._newest = frame
            yield frame
            self._stages.mark(SEARCH)
        close = getattr(frames, "close", None)
        if close is not None:
            close()

    def _show(self, seen: Seen, reception: Reception) -> None:
        """Show the frame before and tell the counts, where they are due, or a pause keeps the next frame back."""
        now, held = time.monotonic(), self.gate.holds
        if self._newest is not None and (now >= self._shown + SCENE_S or held):
            # in step with the screen, unless frames come more slowly
            self._shown = now if now >= self._shown + 2 * SCENE_S else self._shown + SCENE_S
            self._teller.show(seen.scene(self._newest))
        # Time in s from one row of counts to the next. Chosen
        if now >= self._counted + 0.5 or held:
            self._counted = now
            self._teller.tell(self._counts(reception))

    def _counts(self, reception: Reception) -> Row:
        failures, newest = self.failures, self._newest
        row: dict[str, Any] = {
            "event": "state",
            "frames": reception.frames,
            "time_s": 0.0 if newest is None else round(newest.time_s, 6),
            "seconds": round(time.monotonic() - self._began, 3),
            "paused": self.gate.paused,
            "detections": reception.detections,
            "left_out": {"candidates": reception.left_out.dropped, "blocks": reception.left_out.blocks},
            "arrays": reception.report(1.0)["arrays"],
            "stages": {name: round(seconds, 4) for name, seconds in self._stages.seconds.items()},
            "failed": 0 if failures is None else failures.packets,
        }
        if reception.errors is not None:
            row |= {"errors": errors_by_distance(reception.errors), "false_codewords": reception.errors.false_codewords}
        return row


@dataclass(frozen=True, slots=True)
class _Film:
    """Frames of a source as the gate lets them through."""

    source: Source
    frames: Callable[[], Iterator[Frame]]

    @property
    def path(self) -> str:
        return self.source.name

    def __iter__(self) -> Iterator[Frame]:
        return self.frames()


def errors_by_distance(errors: ErrorCounter) -> list[dict[str, Any]]:
    """Codewords wrong of those sent, by distance and layer, with the 95 % interval of their rate, near first."""
    rows = []
    for row in errors.report():
        layers = {}
        for name in LAYERS:
            wrong, sent = row[name]["codeword_errors"], row[name]["codewords"]
            low, high = clopper_pearson(wrong, sent) if sent else (0.0, 1.0)
            layers[name] = {
                "wrong": wrong, "sent": sent, "low": low, "high": high, "raw_wrong": row[name]["raw_errors"],
                "raw_bits": row[name]["raw_bits"],
            }  # fmt: skip
        rows.append({"from_m": row["from_m"], "to_m": row["to_m"], "layers": layers})
    return rows


def _form(source: Source) -> Form:
    return Form(
        width=source.width, height=source.height, bits=source.bits, rate_hz=source.rate_hz, signal=source.signal,
        metadata=source.metadata,
    )  # fmt: skip


def _about(source: Source) -> Row:
    return {
        "event": "source",
        "name": source.name,
        "width": source.width,
        "height": source.height,
        "rate_hz": source.rate_hz,
        "frames": source.frame_count,
        "receiver": source.settings.receive.receiver,
        "packet_s": source.signal.packet_s,
        "side": source.signal.side,
        "live": source.live is not None,
        "truth": source.truth is not None,
    }


def _attend(source: Source, tell: Callable[[Row], None]) -> None:
    """Say what a camera made of its settings, and when it is lost or back; have the receiver's loops ready for it."""
    if source.live is None:
        return
    from heliograph.link.warm_up import warm_up

    def say(text: str) -> None:
        tell({"event": "camera", "text": text})

    for text in source.live.form.departures:
        say(text)
    source.live.say = say
    with contextlib.suppress(HeliographError):
        warm_up(source.signal, source.settings.receive, source.bits)


def _unfinished(reception: Reception) -> list[dict[str, Any]]:
    names = ("id", "layer", "stream", "had", "bytes")
    return [dict(zip(names, one, strict=True)) for one in reception.unfinished()[:40]]
