"""Reception of a film or live camera."""

import contextlib
import json
import os
import re
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

import cv2

from heliograph.base.errors import HeliographError, MediaError
from heliograph.base.files import clear_write_errors, write_whole
from heliograph.base.words import counted
from heliograph.cli import console
from heliograph.cli.files import FileOutput
from heliograph.cli.live import EventOutput, FilmMonitor, monitored
from heliograph.cli.options import ReceiveOptions
from heliograph.link.film import FrameProgress, packet_row, silent
from heliograph.link.settings import LinkSettings
from heliograph.link.truth import check_truth, open_truth, signal_of
from heliograph.measure.counts import LayerCounts
from heliograph.measure.errors import BIN_M, ErrorCounter
from heliograph.measure.journal import Journal, missed_words
from heliograph.measure.reception import Reception, receive_film
from heliograph.media import FilmReader, open_film
from heliograph.media.live.reader import is_camera, live_of
from heliograph.probe import Findings, probe_film
from heliograph.probe.activity import MOST_FRAMES
from heliograph.probe.words import as_mapping, in_short
from heliograph.receive.registry import RECEIVERS
from heliograph.signal.message import Message
from heliograph.signal.settings import SignalSettings

PARTIAL_LOG = ".packets.jsonl.partial"
"""Name of an incomplete packet log."""


@dataclass(frozen=True, slots=True)
class Ending:
    """End of a reception."""

    # Empty after the last frame
    error: str = ""
    is_interrupted: bool = False
    # True if the receiver does not support the film
    is_refused: bool = False


INTERRUPTED = Ending("interrupted", is_interrupted=True)


def run_receive(film: Path, options: ReceiveOptions) -> None:
    """Receive a film or live camera; show the results so far after an early end, and diagnose a missing array."""
    settings = options.settings.load()
    base, changes = options.settings.load_preset(), options.settings.signal_changes()
    if options.truth and is_camera(film):
        raise MediaError("a live camera has no truth: leave out --truth")
    if options.truth and options.film.is_partial:
        raise MediaError("the truth describes complete frames: leave out --crop, --bin and --rotate, or --truth")
    truth = open_truth(options.truth) if options.truth else None
    reception, output = Reception(truth), options.results.output
    files_folder = options.results.files or (output / "files" if output else None)
    files = FileOutput(files_folder, is_quiet=options.is_quiet)
    files.begin(reception.files)
    cv2.setNumThreads(1)  # a second thread is not faster for small images
    with open_film(film, **options.film.keywords(), **options.live.keywords(film)) as source:
        signal, departure = signal_of(source, base.signal, changes)
        if truth is not None:
            check_truth(source, truth, signal)
        if departure:
            console.complain(departure)
        link = _adapted(settings, source)
        with (
            ResultFolder(output) as folder,
            EventOutput(options.events) as events,
            monitored(source, options.live, signal, link.receive, is_quiet=options.is_quiet) as monitor,
        ):
            start_s = time.perf_counter()
            with console.progress("receiving", monitor.frame_count) as advance:
                ending = receive_packets(monitor, signal, link, reception, folder, events, files, advance)
            report = {"film": str(film), **reception.report(time.perf_counter() - start_s)}
            report["reading_seconds"] = source.read_s
            findings = None
            try:
                if not monitor.is_live and is_unexplained(report, ending):
                    findings = probe_unread(source, signal, settings, report)
            except KeyboardInterrupt:
                ending = INTERRUPTED
            if findings is not None and findings.screen is not None and ending.is_refused:
                # the receiver for arrays refuses the frame rate of films of screens
                ending = Ending(f"{film} shows a screen: {findings.screen.advice[0]}")
            if ending.error:
                report["error"] = ending.error
            try:
                report |= monitor.finish()
                folder.finish(report)
                files.finish(reception.files)
            except MediaError as error:
                ending = Ending(str(error))
            events.tell({"event": "end", **report})
    if options.as_json and not options.events.follow:
        console.say_json(report)
    elif not options.events.follow:
        _show(report, reception, folder, monitor.unseen)
        for line in files.incomplete_lines(reception.files, reception.frames / source.rate_hz):
            console.say_prose(line)
        _show_findings(findings, film)
        if monitor.is_live and not report["arrays"]:
            command = f"heliograph probe {console.argument(monitor.recorded or film)}"
            console.say_prose(f"'{command}' describes the frames, and explains why no array is read")
        monitor.show()
        if not monitor.is_live:
            _show_reading_time(source, report)
    if ending.is_interrupted:
        console.exit_interrupted(
            f"interrupted after {counted(reception.frames, 'frame')}; the results so far are above"
        )
    if ending.error:
        raise HeliographError(ending.error)
    exit_without_array(report)


def receive_packets(
    monitor: FilmMonitor,
    signal: SignalSettings,
    settings: LinkSettings,
    reception: Reception,
    folder: "ResultFolder",
    events: EventOutput,
    files: FileOutput,
    advance: FrameProgress = silent,
) -> Ending:
    """Receive all packets."""
    journal = Journal(settings.receive.calibration, events.tell)

    def observe(event: Any) -> None:
        journal.observe(event)
        monitor.observe(event)

    try:
        for packet, messages in receive_film(monitor, signal, settings, reception, observe, advance):
            folder.log(packet_row(packet, reception.confirmed))
            journal.read(packet, messages, reception.progress)
            monitor.add_packet(packet)
            for message in messages:
                folder.write_message(message)
                monitor.show_message(message)
            for progress in reception.progress:
                files.update(progress)
    except KeyboardInterrupt:
        return INTERRUPTED
    except (HeliographError, OSError, MemoryError) as error:
        is_refused = isinstance(error, HeliographError) and not isinstance(error, MediaError)
        return Ending(console.error_text(error), is_refused=is_refused)
    return Ending()


def is_unexplained(report: dict[str, Any], ending: Ending) -> bool:
    """Return True if a diagnosis must explain a missing array."""
    return not report["arrays"] and (ending.is_refused or not ending.error)


def exit_without_array(*reports: dict[str, Any]) -> None:
    """Exit with status 3 if no reception decoded a codeword of an array."""
    if not any(report["arrays"] for report in reports):
        sys.exit(console.NO_ARRAY)


def probe_unread(
    source: FilmReader,
    signal: SignalSettings,
    settings: LinkSettings,
    report: dict[str, Any],
    *,
    is_quiet: bool = False,
) -> Findings:
    """Diagnose an unreadable film, and add the findings to the report; sample sections of a long film."""
    most, every = 8 * MOST_FRAMES, 1
    if source.frame_count is not None:
        every, most = max(1, source.frame_count // most), source.frame_count
    with contextlib.nullcontext(silent) if is_quiet else console.progress("asking why", most) as advance:
        findings = probe_film(source, signal, settings.receive, advance, reading=False, every=every, most=most)
    report["probe"] = as_mapping(findings)
    if isinstance(findings.broken, KeyboardInterrupt):
        raise findings.broken
    return findings


def _adapted(settings: LinkSettings, source: FilmReader) -> LinkSettings:
    """Limit the search time of live cameras, and decode in a second process for live cameras and long films."""
    receive, is_live = settings.receive, live_of(source) is not None
    if is_live:
        receive = receive.with_live_limits()
    # a second process takes two seconds to start
    is_long = is_live or (source.frame_count or 0) >= 4000
    is_default = receive.decode.in_background is None and RECEIVERS.is_built_in(receive.receiver)
    if is_default and is_long and (os.cpu_count() or 1) >= 2:
        receive = replace(receive, decode=replace(receive.decode, in_background=True))
    return replace(settings, receive=receive)


class ResultFolder:
    """Folder of the results of a film, or no output for None; a complete reception removes older messages."""

    def __init__(self, path: Path | None):
        self.path = path
        self.messages: list[str] = []
        self._log: IO[str] | None = None

    def __enter__(self) -> "ResultFolder":
        if self.path is not None:
            with clear_write_errors(self.path):
                self.path.mkdir(parents=True, exist_ok=True)
                self._log = (self.path / PARTIAL_LOG).open("w", encoding="utf-8")
        return self

    def __exit__(self, *_: object) -> None:
        if self._log is not None and self.path is not None:
            with contextlib.suppress(OSError):  # a full disk
                self._log.close()
            (self.path / PARTIAL_LOG).unlink(missing_ok=True)

    def log(self, row: Any) -> None:
        """Append a row to the packet log."""
        if self._log is not None and self.path is not None:
            with clear_write_errors(self.path / "packets.jsonl"):
                self._log.write(json.dumps(row) + "\n")

    def write_message(self, message: Message) -> None:
        """Write a message to a file."""
        if self.path is not None:
            name = f"array-{message.identity}-{message.layer}-{message.stream}.bin"
            write_whole(self.path / name, message.data)
            self.messages.append(name)

    def finish(self, report: Any) -> None:
        """Complete the packet log, write the summary, and remove messages of an earlier film."""
        if self._log is None or self.path is None:
            return
        with clear_write_errors(self.path / "packets.jsonl"):
            self._log.close()
            os.replace(self.path / PARTIAL_LOG, self.path / "packets.jsonl")
        write_whole(self.path / "summary.json", json.dumps(report, indent=1).encode())
        if "error" in report:
            return
        for old in self.path.glob("array-*-*-*.bin"):
            if re.fullmatch(r"array-\d+-[a-z]+-\d+\.bin", old.name) and old.name not in self.messages:
                with clear_write_errors(old):
                    old.unlink(missing_ok=True)


def _show(report: dict[str, Any], reception: Reception, folder: ResultFolder, unseen: str) -> None:
    """Print the results."""
    detections = counted(report["detections"], "detection")
    console.say(
        f"{counted(report['frames'], 'frame')} in {report['seconds']:.1f} s "
        f"({report['frames_per_second']:.0f} frames/s)" + (f", {detections}" if report["arrays"] else "")
    )
    if report["dropped_candidates"] or report["dropped_blocks"]:
        skipped = (
            f"{counted(report['dropped_candidates'], 'candidate')} and {counted(report['dropped_blocks'], 'block')}"
        )
        console.say_prose(
            f"the search skipped {skipped} to limit the CPU time; set --region, or raise receive.detect.cpu_share"
        )
    if not report["arrays"]:
        cause = unseen or (f"{detections} without a decoded codeword" if report["detections"] else "")
        console.say(f"no array found: {cause}" if cause else "no array found")
    for array in report["uncertain"]:
        console.say(f"uncertain, no codeword decoded: {_array_text(array)}")
    for array in report["arrays"]:
        console.say(_array_text(array))
        for layer, tally in array["layers"].items():
            codewords = counted(tally["ok"], "codeword")
            console.say(f"  {layer:6} {codewords} read, {tally['failed']} not, {tally['bytes']} bytes")
    for missed in report["missed_starts"]:
        console.say(missed_words(missed))
    for name in folder.messages:
        console.say(f"message {folder.path}/{name}")
    for identity, layer, stream, received, size in reception.unfinished():
        missing = f"{size - received} missing: film longer, or until the array repeats the message"
        console.say(f"array {identity}, {layer}, message {stream}: {received} of {size} bytes, {missing}")
    if reception.errors is not None:
        _show_errors(reception.errors)


def _array_text(array: dict[str, Any]) -> str:
    return (
        f"array {array['id']}: {counted(array['packets'], 'packet')}, "
        f"frames {array['first_frame']} to {array['last_frame']}, "
        f"{array['first_distance_m']:.1f} m to {array['last_distance_m']:.1f} m away"
    )


def _show_findings(findings: Findings | None, film: Path) -> None:
    """Print why no array was read."""
    if findings is None:
        return
    for line in in_short(findings):
        console.say_prose(line)
    console.note(f"'heliograph probe {console.argument(film)} --output DIR' gives details, with pictures")


def _show_reading_time(source: FilmReader, report: dict[str, Any]) -> None:
    """Recommend a faster container if reading takes most of the time."""
    reading_s = report["reading_seconds"]
    is_slow = reading_s > max(2.0, report["frames"] / source.rate_hz) and reading_s > 0.5 * report["seconds"]
    if is_slow and source.faster:
        are = "is" if len(source.faster) == 1 else "are"
        faster = source.path.parent / f"{source.path.stem or 'film'}.h5"
        console.note(
            f"reading the film took {reading_s:.1f} s: {' and '.join(source.faster)} {are} read faster, see "
            f"'heliograph convert {console.argument(source.path)} {console.argument(faster)}'"
        )


def _show_errors(errors: ErrorCounter) -> None:
    console.say("distance      bit error rate of bits, codewords wrong/sent: high, middle, low")
    for start, layers in errors.bins().items():
        cells = "   ".join(_cell(counts) for counts in layers.values())
        console.say(f"{start:5.0f}-{start + BIN_M:<4.0f} m  {cells}")
    console.say(f"packets that were not sent: {errors.false_packets}")
    if errors.uncertain_packets:
        console.say(f"packets of uncertain identity, no codeword decoded: {errors.uncertain_packets}")
    console.say(f"accepted codewords that were not sent: {errors.false_codewords}")


def _cell(counts: LayerCounts) -> str:
    bits, words = counts.decoded_bits, counts.words
    return f"{bits.text():>9} of {bits.trials:<7d} {words.errors:3d}/{words.trials:<3d}"
