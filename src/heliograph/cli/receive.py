"""heliograph receive."""

import contextlib
import json
import os
import re
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from heliograph.base.errors import HeliographError, MediaError
from heliograph.base.files import clear_write_errors, write_whole
from heliograph.base.words import counted
from heliograph.cli import console, options
from heliograph.cli.files import Files
from heliograph.cli.live import LiveOptions, News, Told, Watch, watched

FILES = "files"
"""Folder of whole files in that of all results, where none is named."""

PARTIAL_LOG = ".packets.jsonl.partial"
"""What the packet log is called until it is whole."""

MESSAGE_NAME = re.compile(r"array-\d+-[a-z]+-\d+\.bin")
"""What messages are called in the folder of results."""

if TYPE_CHECKING:
    from heliograph.link.film import FrameProgress
    from heliograph.link.settings import LinkSettings
    from heliograph.measure.counts import LayerCounts
    from heliograph.measure.errors import ErrorCounter
    from heliograph.measure.reception import Reception
    from heliograph.media import FilmReader
    from heliograph.probe import Findings
    from heliograph.signal.message import Message
    from heliograph.signal.settings import SignalSettings


def run_receive(
    film: Path,
    seen: options.FilmOptions,
    output: Path | None,
    truth: Path | None,
    preset: str,
    file: Path | None,
    changes: list[str],
    as_json: bool,
    told: Told,
    live: LiveOptions,
    files: Path | None = None,
) -> None:
    """Read a film; whatever ends it, what was decoded before is kept and shown. Where nothing was, it is said why.

    What the film notes of its signal wins over the preset; file and assignments win over the note.
    """
    import cv2

    from heliograph.cli.probe import found_array, why_unread
    from heliograph.link.truth import check_truth, open_truth, signal_of
    from heliograph.measure.reception import Reception
    from heliograph.media import open_film
    from heliograph.media.live.reader import is_camera

    settings = options.settings_from(preset, file, changes)
    base, signal_changes = options.settings_from(preset, None, None), options.signal_changes(file, changes)
    if truth and is_camera(film):
        raise MediaError("a live camera has no truth: leave out --truth")
    if truth and seen.partly:
        raise MediaError("the truth is that of the whole film: leave out --crop, --bin and --rotate, or --truth")
    known = open_truth(truth) if truth else None
    reception = Reception(known)
    kept = Files(files or (output / FILES if output else None), aloud=not as_json and not told.follow)
    kept.begin(reception.files)
    # its images are small: a second thread would only wait, and take a core
    cv2.setNumThreads(1)
    with open_film(film, **seen.keywords(), **live.keywords(film)) as source:
        signal, departure = signal_of(source, base.signal, signal_changes)
        if known is not None:
            check_truth(source, known, signal)
        if departure:
            console.complain(departure)
        aloud, reading = not as_json and not told.follow, _in_time(_on_all_cores(settings, source), source)
        with (
            Folder(output) as folder,
            News(told) as news,
            watched(source, live, signal, reading.receive, aloud) as watch,
        ):
            began = time.perf_counter()
            with console.progress("receiving", watch.frame_count) as advance:
                ending = read_film(watch, signal, reading, reception, (folder, news, kept), advance)
            report = {"film": str(film), **reception.report(time.perf_counter() - began)}
            report["reading_seconds"] = source.read_s
            try:
                # what a camera shows is gone
                why = None if watch.is_live else why_unread(source, signal, settings, report, ending)
            except KeyboardInterrupt as error:
                why, ending = None, error
            if why is not None and why.screen is not None and isinstance(ending, HeliographError):
                # the receiver for arrays refused the rate of a screen's film
                ending = HeliographError(f"{film} shows a screen: {why.screen.advice[0]}")
            if ending is not None:
                report["error"] = ended(ending)
            ending = finish_folder(folder, report, watch) or kept.finish(reception.files) or ending
            news.tell({"event": "end", **report})
    if told.follow:
        pass  # its last line has the report
    elif as_json:
        console.say_json(report)
    else:
        _show(report, reception, folder, watch.unseen)
        for line in kept.lacking(reception.files, reception.frames / source.rate_hz):
            console.say_prose(line)
        _show_why(why, film)
        if watch.is_live and not found_array(report):
            seen_by = watch.recorded or film
            command = f"heliograph probe {console.argument(seen_by)}"
            console.say_prose(f"'{command}' tells what the camera shows, and why no array is read")
        watch.show()
        if not watch.is_live:
            _show_reading(source, report)
    if isinstance(ending, KeyboardInterrupt):
        console.complain(f"interrupted after {counted(reception.frames, 'frame')}; the results so far are above")
        sys.exit(console.INTERRUPTED)
    if ending is not None:
        raise ending
    if not found_array(report):
        sys.exit(console.NO_ARRAY)


def read_film(
    watch: Watch,
    signal: "SignalSettings",
    settings: "LinkSettings",
    reception: "Reception",
    told: tuple["Folder", News, Files],
    advance: "FrameProgress | None" = None,
) -> BaseException | None:
    """Read the film to its end, or until something ends it: that is returned."""
    from heliograph.link.film import packet_row, silent
    from heliograph.measure.journal import Journal
    from heliograph.measure.reception import receive_film

    folder, news, files = told
    journal = Journal(settings.receive.calibration, news.tell)

    def observe(event: Any) -> None:
        journal.observe(event)
        watch.observe(event)

    try:
        for packet, messages in receive_film(watch, signal, settings, reception, observe, advance or silent):
            folder.log(packet_row(packet, reception.confirmed))
            journal.read(packet, messages, reception.progress)
            watch.packet(packet)
            for message in messages:
                folder.message(message)
                watch.message(message)
            for progress in reception.progress:
                files.took(progress)
    except (HeliographError, OSError, MemoryError, KeyboardInterrupt) as error:
        return error
    return None


def _on_all_cores(settings: "LinkSettings", source: "FilmReader") -> "LinkSettings":
    """Settings by which packets are decoded beside the frames that follow, where there is a core and reason for it."""
    from heliograph.media.live.reader import live_of
    from heliograph.receive.registry import RECEIVERS

    receive = settings.receive
    asked = receive.decode.in_background is not None or not RECEIVERS.is_built_in(receive.receiver)
    # Frames of a film from which on another process decodes its packets. Chosen: it takes two seconds to begin
    long = live_of(source) is not None or (source.frame_count or 0) >= 4000
    if asked or not long or (os.cpu_count() or 1) < 2:
        return settings
    return replace(settings, receive=replace(receive, decode=replace(receive.decode, in_background=True)))


def _in_time(settings: "LinkSettings", source: "FilmReader") -> "LinkSettings":
    """Settings by which a search has a bound where a live camera does not wait for it."""
    from heliograph.media.live.reader import live_of

    return settings if live_of(source) is None else replace(settings, receive=settings.receive.with_live_limits())


def ended(ending: BaseException) -> str:
    """What ended a film early, in a line."""
    return "interrupted" if isinstance(ending, KeyboardInterrupt) else str(ending)


def finish_folder(folder: "Folder", report: dict[str, Any], watch: Watch) -> MediaError | None:
    """Finish all files; a failure is returned, for the results are still to be shown."""
    try:
        report |= watch.finish()
        folder.finish(report)
    except MediaError as error:
        return error
    return None


class Folder:
    """The folder results go to, or nowhere: files appear whole, the packet log when all is read.

    It holds the results of one film: messages of an earlier one are removed when this one was received to its end.
    """

    def __init__(self, path: Path | None):
        self.path = path
        self.messages: list[str] = []
        self._log: IO[str] | None = None
        self._partial = (path or Path()) / PARTIAL_LOG

    def __enter__(self) -> "Folder":
        if self.path is not None:
            with clear_write_errors(self.path):
                self.path.mkdir(parents=True, exist_ok=True)
                self._log = self._partial.open("w", encoding="utf-8")
        return self

    def __exit__(self, *_: object) -> None:
        if self._log is not None:
            with contextlib.suppress(OSError):  # what is buffered may find no room
                self._log.close()
            self._partial.unlink(missing_ok=True)

    def log(self, row: Any) -> None:
        """Append a line to the packet log."""
        if self._log is not None and self.path is not None:
            with clear_write_errors(self.path / "packets.jsonl"):
                self._log.write(json.dumps(row) + "\n")

    def message(self, message: "Message") -> None:
        """Write a message."""
        if self.path is not None:
            name = f"array-{message.identity}-{message.layer}-{message.stream}.bin"
            write_whole(self.path / name, message.data)
            self.messages.append(name)

    def finish(self, report: Any) -> None:
        """Put the packet log in its place, and write the summary."""
        if self._log is not None and self.path is not None:
            with clear_write_errors(self.path / "packets.jsonl"):
                self._log.close()
                os.replace(self._partial, self.path / "packets.jsonl")
            write_whole(self.path / "summary.json", json.dumps(report, indent=1).encode())
            if "error" not in report:
                self._forget_others(self.path)

    def _forget_others(self, path: Path) -> None:
        """Remove messages of another film."""
        for old in path.glob("array-*-*-*.bin"):
            if MESSAGE_NAME.fullmatch(old.name) and old.name not in self.messages:
                with clear_write_errors(old):
                    old.unlink(missing_ok=True)


def _show(report: dict[str, Any], reception: "Reception", folder: Folder, unseen: str) -> None:
    from heliograph.measure.journal import missed_words

    console.say(
        f"{counted(report['frames'], 'frame')} in {report['seconds']:.1f} s "
        f"({report['frames_per_second']:.0f} frames/s)"
        + (f", {counted(report['detections'], 'detection')}" if report["arrays"] else "")
    )
    if report["dropped_candidates"] or report["dropped_blocks"]:
        left = f"{counted(report['dropped_candidates'], 'candidate')} and {counted(report['dropped_blocks'], 'block')}"
        console.say_prose(
            f"more alternates in these frames than searching may cost: {left} were left out; say by --region where the "
            f"array is, or raise receive.detect.cpu_share"
        )
    if not report["arrays"]:
        found = report["detections"]
        cause = unseen or (f"{counted(found, 'detection')} without a decoded codeword" if found else "")
        console.say(f"no array found: {cause}" if cause else "no array found")
    for array in report["uncertain"]:
        console.say(f"uncertain, no codeword decoded: {_array_line(array)}")
    for array in report["arrays"]:
        console.say(_array_line(array))
        for layer, t in array["layers"].items():
            console.say(f"  {layer:6} {counted(t['ok'], 'codeword')} read, {t['failed']} not, {t['bytes']} bytes")
    for missed in report["missed_starts"]:
        console.say(missed_words(missed))
    for name in folder.messages:
        console.say(f"message {folder.path}/{name}")
    for identity, layer, stream, had, size in reception.unfinished():
        missing = f"{size - had} missing: film longer, or until the array repeats the message"
        console.say(f"array {identity}, {layer}, message {stream}: {had} of {size} bytes, {missing}")
    if reception.errors is not None:
        _show_errors(reception.errors)


def _array_line(array: dict[str, Any]) -> str:
    return (
        f"array {array['id']}: {counted(array['packets'], 'packet')}, "
        f"frames {array['first_frame']} to {array['last_frame']}, "
        f"{array['first_distance_m']:.1f} m to {array['last_distance_m']:.1f} m away"
    )


def _show_why(why: "Findings | None", film: Path) -> None:
    """Say in short why nothing was read."""
    if why is None:
        return
    from heliograph.probe.words import in_short

    for line in in_short(why):
        console.say_prose(line)
    console.note(f"'heliograph probe {console.argument(film)} --output DIR' tells more, with pictures")


def _show_reading(source: "FilmReader", report: dict[str, Any]) -> None:
    """Say so once where the container is what takes the time."""
    reading_s = report["reading_seconds"]
    # Seconds of reading from which on a faster container is worth a word. Chosen
    slow = reading_s > max(2.0, report["frames"] / source.rate_hz)
    if slow and reading_s > 0.5 * report["seconds"] and source.faster:
        is_are = "is" if len(source.faster) == 1 else "are"
        faster = source.path.parent / f"{source.path.stem or 'film'}.h5"
        console.note(
            f"{reading_s:.1f} s of these were spent waiting for the film: {' and '.join(source.faster)} {is_are} read "
            f"faster, see 'heliograph convert {console.argument(source.path)} {console.argument(faster)}'"
        )


def _show_errors(errors: "ErrorCounter") -> None:
    from heliograph.measure.errors import BIN_M

    console.say("distance      bit error rate of so many bits, codewords wrong/sent: high, middle, low")
    for start, layers in errors.bins().items():
        cells = "   ".join(_cell(counts) for counts in layers.values())
        console.say(f"{start:5.0f}-{start + BIN_M:<4.0f} m  {cells}")
    console.say(f"packets that were not sent: {errors.false_packets}")
    if errors.uncertain_packets:
        console.say(f"packets of uncertain identity, no codeword decoded: {errors.uncertain_packets}")
    console.say(f"codewords taken for right that were not sent: {errors.false_codewords}")


def _cell(counts: "LayerCounts") -> str:
    bits, words = counts.decoded_bits, counts.words
    return f"{bits.text():>9} of {bits.trials:<7d} {words.errors:3d}/{words.trials:<3d}"
