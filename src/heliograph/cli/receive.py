"""heliograph receive."""

import contextlib
import json
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from heliograph.base.errors import HeliographError, MediaError
from heliograph.cli import console, options


def run_receive(
    film: Path,
    receiver: str | None,
    output: Path | None,
    truth: Path | None,
    preset: str,
    file: Path | None,
    assignments: list[str] | None,
    as_json: bool,
) -> None:
    """Read a film; whatever ends it, what was decoded before is kept and shown."""
    from heliograph.link.film import signal_of
    from heliograph.link.reception import Reception
    from heliograph.link.truth import open_truth
    from heliograph.media import open_film

    changes = [*(assignments or ()), *([f"receive.receiver='{receiver}'"] if receiver else ())]
    settings = options.settings_from(preset, file, changes)
    chosen = file is not None or any(c.startswith("signal.") for c in changes)
    reception = Reception(open_truth(truth) if truth else None)
    began = time.perf_counter()
    ending: BaseException | None = None
    with Folder(output) as folder, open_film(film) as source:
        signal = signal_of(source, settings, chosen)
        try:
            _read(source, signal, settings, reception, folder)
        except (HeliographError, KeyboardInterrupt) as error:
            ending = error
        report = reception.report(time.perf_counter() - began)
        folder.write("summary.json", json.dumps(report, indent=1).encode())
    console.say_json(report) if as_json else _show(report, reception, folder)
    if isinstance(ending, KeyboardInterrupt):
        console.complain(f"interrupted after {reception.frames} frames; the results so far are above")
        sys.exit(console.INTERRUPTED)
    if ending is not None:
        raise ending


def _read(source, signal, settings, reception, folder) -> None:  # type: ignore[no-untyped-def]
    from heliograph.link.film import packet_row, receive_film

    with console.progress("receiving", source.frame_count) as advance:
        for packet, messages in receive_film(source, signal, settings, reception, progress=advance):
            folder.log(packet_row(packet))
            for message in messages:
                folder.write(f"array-{message.identity}-{message.layer}-{message.stream}.bin", message.data)


class Folder:
    """The folder results go to, or nowhere: files appear whole, the packet log when all is read.

    Parameters
    ----------
    path
        The folder, made if it does not exist; None writes nothing.
    """

    def __init__(self, path: Path | None):
        self.path = path
        self.written: list[str] = []
        self._log: IO[str] | None = None

    def __enter__(self) -> "Folder":
        if self.path is not None:
            with _clear(self.path):
                self.path.mkdir(parents=True, exist_ok=True)
                self._log = (self.path / ".packets.jsonl.partial").open("w", encoding="utf-8")
        return self

    def __exit__(self, *_: object) -> None:
        if self._log is not None and self.path is not None:
            self._log.close()
            os.replace(self._log.name, self.path / "packets.jsonl")

    def log(self, row: Any) -> None:
        """Append a line to the packet log."""
        if self._log is not None:
            with _clear(self.path):
                self._log.write(json.dumps(row) + "\n")

    def write(self, name: str, data: bytes) -> None:
        """Write a file whole."""
        if self.path is None:
            return
        partial = self.path / f".{name}.partial"
        with _clear(self.path):
            try:
                partial.write_bytes(data)
                os.replace(partial, self.path / name)
            finally:
                partial.unlink(missing_ok=True)
        self.written.append(name)


@contextlib.contextmanager
def _clear(path: Path | None) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise MediaError(f"cannot write to {path}: {error.strerror}; make room or choose another --output") from None


def _show(report: dict[str, Any], reception, folder: Folder) -> None:  # type: ignore[no-untyped-def]
    console.say(f"{report['frames']} frames in {report['seconds']:.1f} s ({report['frames_per_second']:.0f} frames/s)")
    if not report["arrays"]:
        console.say("no array found")
    for array in report["arrays"]:
        console.say(
            f"array {array['id']}: {array['packets']} packets, frames {array['first_frame']} to {array['last_frame']}"
        )
        for layer, t in array["layers"].items():
            console.say(f"  {layer:6} {t['ok']} codewords read, {t['failed']} not, {t['bytes']} bytes")
    for name in folder.written[:-1]:
        console.say(f"message {folder.path}/{name}")
    for identity, layer, stream, had, size in reception.unfinished():
        console.say(f"array {identity}, {layer}, message {stream}: {had} of {size} bytes")
    if reception.errors is not None:
        _show_errors(reception)


def _show_errors(reception) -> None:  # type: ignore[no-untyped-def]
    console.say("distance      bit error rate, codewords wrong of sent: high, middle, low")
    for start, layers in reception.errors.bins().items():
        cells = [f"{e.bits.text():>10} {e.codewords.errors:3d}/{e.codewords.trials:<3d}" for e in layers.values()]
        console.say(f"{start:5.0f}-{start + 5:<4.0f} m  " + "   ".join(cells))
    console.say(f"codewords taken for right that were not sent: {reception.errors.false_codewords}")
