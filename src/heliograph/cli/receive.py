"""Command for the reception of films and live cameras, one or many in parallel."""

import contextlib
import glob
import json
import os
import re
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import IO, Annotated, Any

import cv2
import typer

from heliograph import __version__
from heliograph.base.errors import HeliographError, MediaError, counted
from heliograph.base.files import clear_write_errors, write_whole
from heliograph.cli import console, options
from heliograph.cli.files import FileOutput, join
from heliograph.cli.first_use import compile_ahead
from heliograph.cli.live import FilmMonitor, monitored, open_events, open_logs
from heliograph.cli.options import ReceiveOptions, WorkerOptions, option
from heliograph.link.film import packet_row
from heliograph.link.settings import LinkSettings
from heliograph.link.truth import TruthFile, check_truth, open_truth
from heliograph.measure.errors import BIN_M, ErrorCounter
from heliograph.measure.journal import Journal, missed_words
from heliograph.measure.reception import ReceptionCounter, receive_and_count
from heliograph.media import FilmReader, open_film, tiff
from heliograph.media.images import PICTURE_SUFFIXES, is_pattern
from heliograph.media.live.reader import film_path, is_camera, live_of
from heliograph.probe import Findings, probe_film
from heliograph.probe.activity import MOST_FRAMES
from heliograph.probe.screens import with_receiver_for
from heliograph.probe.words import as_mapping, in_short
from heliograph.receive.registry import RECEIVERS
from heliograph.road.codec import road_values, road_words
from heliograph.signal.message import Message
from heliograph.sweeps.executors import Workers, fewer_workers, open_workers

PARTIAL_LOG = ".packets.jsonl.partial"  # name of an incomplete packet log

FILMS = {".mkv", ".nut", ".mp4", ".mov", ".m4v", ".webm", ".avi", ".y4m", ".ts", ".m2ts", ".wmv", ".flv", ".h264",
         ".h265", ".hevc", ".h5", ".hdf5", ".mat", ".mraw", ".cine", ".npy"}  # fmt: skip
"""Suffixes of films in a folder; the pictures of a folder are the frames of a film."""

Row = dict[str, Any]  # result of a film


@dataclass(slots=True)
class Outcome:
    """Results of a reception, up to an error."""

    report: Row
    reception: ReceptionCounter
    monitor: FilmMonitor
    files: FileOutput
    # Names of the written messages
    messages: list[str]
    # Diagnosis of a missing array
    findings: Findings | None = None


@options.command
def receive(
    films: Annotated[list[Path], typer.Argument(metavar="FILM...", parser=film_path, help=options.FILM_KINDS)],
    *,
    detect: options.DetectOptions,
    results: options.OutputOptions,
    truth: Path | None = option("Truth of the film, for error counts.", "FILE"),
    film: options.FilmOptions,
    settings: options.SettingsOptions,
    live: options.RecordOptions,
    as_json: options.Json = False,
    events: options.EventOptions,
    crew: options.WorkerOptions,
) -> None:
    """Find arrays in films or live cameras, and read the messages.

    If no array is found, the cause is diagnosed.

    A live camera is camera:KIND or camera:KIND:ADDRESS; 'heliograph cameras' lists the connected cameras. The reception
    ends with Ctrl-C, after --duration S, or at the end of the camera.

    Films of 'simulate' contain a note of the signal, which overrides the preset. --settings and --set override the
    note; a line reports differences. For several films, or a folder of films, the output is a line of JSON for each
    film; --output has a folder for each film, and existing results are not computed again. The exit status is 3 if no
    array was found in any film.
    """
    chosen = settings.changed(overrides=detect.assignments())
    request = ReceiveOptions(film, chosen, results, live, events, as_json, settings.is_auto(detect.receiver))
    chosen.load()  # reports invalid settings once
    if not is_many(films) and crew == options.WorkerOptions():
        reports = [_receive_single(films[0], request, truth)]
    else:
        is_watched = events.follow or events.send or events.verbose or results.rerun or results.replay
        if truth or live.camera or live.record or live.duration is not None or is_watched:
            raise MediaError(
                "--truth, --follow, --send, --verbose, --replay, --rerun and options of cameras accept a single film: "
                "receive the films in turn"
            )
        reports = run_many(films, request, crew)
    if not any(report["arrays"] for report in reports):
        sys.exit(console.NO_ARRAY)


def _receive_single(film: Path, request: ReceiveOptions, truth_path: Path | None) -> Row:
    """Receive a film or live camera; show the results so far after an early end, and diagnose a missing array."""
    if truth_path and is_camera(film):
        raise MediaError("a live camera has no truth: leave out --truth")
    if truth_path and request.film.is_partial:
        raise MediaError("the truth describes complete frames: leave out --crop, --bin and --rotate, or --truth")
    truth = open_truth(truth_path) if truth_path else None
    cv2.setNumThreads(1)  # a second thread is not faster for small images
    compile_ahead()
    report: Row = {"film": str(film)}
    try:
        with open_film(film, **request.film.keywords(), **request.live.keywords(film)) as source:
            receive_source(source, report, request, truth)
    except KeyboardInterrupt:
        if "frames" not in report:  # no reception has begun
            raise
        frames = counted(report["frames"], "frame")
        console.exit_interrupted(f"interrupted after {frames}; the results so far are above")
    return report


def receive_source(
    source: FilmReader,
    report: Row,
    options: ReceiveOptions,
    truth: TruthFile | None = None,
    origin: Mapping[str, Any] | None = None,
) -> None:
    """Receive a film or live camera; add the results to the report and show them, also before an error is raised.

    A film with an origin is one of many, and is received silently.
    """
    settings, is_batch = options.settings.load(), origin is not None
    is_quiet = is_batch or options.is_quiet
    signal, departure = options.settings.signal_of(source)
    if truth is not None:
        check_truth(source, truth, signal)
    if departure and not is_batch:
        console.complain(departure)
    if options.is_auto:
        settings, choice = with_receiver_for(source, signal, settings)
        if not is_quiet:
            console.say(choice)
    link = settings if is_batch else _adapted(settings, source)
    reception, files = ReceptionCounter(truth), FileOutput(options.files_folder, is_quiet=is_quiet)
    files.begin(reception.files)

    def receive_packets() -> None:
        journal, start_s = Journal(settings.receive.calibration, tell), time.perf_counter()

        def observe(event: Any) -> None:
            journal.observe(event)
            monitor.observe(event)

        try:
            with console.progress("receiving", source.frame_count, is_hidden=is_batch) as advance:
                for packet, messages in receive_and_count(monitor, signal, link, reception, observe, advance):
                    folder.log(packet_row(packet, reception.confirmed))
                    journal.read(packet, messages, reception.progress)
                    monitor.add_packet(packet)
                    for message in messages:
                        folder.write_message(message)
                        if not is_quiet:
                            console.say(_message_text(message))
                    for file in reception.progress:
                        files.update(file)
        finally:
            report.update(receiver=settings.receive.receiver, **reception.report(time.perf_counter() - start_s))
            batch = {"messages": folder.messages, **({"departure": departure} if departure else {})}
            report.update(batch if is_batch else {"reading_seconds": source.read_s})

    def diagnose(*, is_refused: bool) -> None:
        if monitor.live is not None or report["arrays"]:
            return
        # sample sections of a long film
        most = source.frame_count or 8 * MOST_FRAMES
        every = max(1, most // (8 * MOST_FRAMES))
        with console.progress("asking why", most, is_hidden=is_batch) as advance:
            findings = probe_film(source, signal, settings.receive, advance, reading=False, every=every, most=most)
        outcome.findings, report["probe"] = findings, as_mapping(findings)
        if findings.broken == "interrupted":
            raise KeyboardInterrupt
        if findings.screen is not None and is_refused and not is_batch:
            # the receiver for arrays refuses the frame rate of films of screens
            raise HeliographError(f"{report['film']} shows a screen: {findings.screen.advice[0]}")

    def finish() -> None:
        try:
            report.update(monitor.finish())
            folder.finish(report if origin is None else {**report, "made_of": origin})
            files.finish(reception.files)
        except (KeyboardInterrupt, MediaError) as error:
            report["error"] = console.error_line(error)
            raise
        finally:
            tell({"event": "end", **report})
            stack.close()  # an error would discard the recordings
            if not is_quiet:
                _show(outcome, options.results.output)
                _show_end(outcome, source)
            elif not (is_batch or options.events.follow):
                console.say_json(report)

    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(open_results(options.results.output))
        logs = stack.enter_context(open_logs(options.results, source, signal, settings.receive, reception))
        tell = stack.enter_context(open_events(options.events, logs))
        monitor = stack.enter_context(monitored(source, options.live, signal, link.receive, logs))
        outcome = Outcome(report, reception, monitor, files, folder.messages)
        try:
            try:
                receive_packets()
            except HeliographError as error:
                if not isinstance(error, MediaError):  # the receiver does not support the film
                    diagnose(is_refused=True)
                raise
            diagnose(is_refused=False)
        except (KeyboardInterrupt, HeliographError, OSError, MemoryError) as error:
            report["error"] = console.error_line(error)
            finish()
            raise
        finish()


def _adapted(settings: LinkSettings, source: FilmReader) -> LinkSettings:
    """Limit the search time of live cameras, and decode in a second process for live cameras and long films."""
    receive, is_live = settings.receive, live_of(source) is not None
    if is_live:
        receive = receive.with_live_limits()
    # a second process takes two seconds to start
    is_long = is_live or (source.frame_count or 0) >= 4000
    is_default = receive.decode.in_background is None and receive.receiver in RECEIVERS.built_in
    if is_default and is_long and (os.cpu_count() or 1) >= 2:
        receive = replace(receive, decode=replace(receive.decode, in_background=True))
    return replace(settings, receive=receive)


class ResultFolder:
    """Folder of the results of a film, or no output; a complete reception removes older messages."""

    def __init__(self, path: Path | None, log: IO[str]):
        self.path, self._log = path, log
        self.messages: list[str] = []

    def log(self, row: Any) -> None:
        """Append a row to the packet log."""
        with clear_write_errors(Path(self._log.name)):
            self._log.write(json.dumps(row) + "\n")

    def write_message(self, message: Message) -> None:
        """Write a message to a file."""
        if self.path is not None:
            name = f"array-{message.identity}-{message.layer}-{message.stream}.bin"
            write_whole(self.path / name, message.data)
            self.messages.append(name)

    def finish(self, report: Any) -> None:
        """Complete the packet log, write the summary, and remove messages of an earlier film."""
        if self.path is None:
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


@contextlib.contextmanager
def open_results(path: Path | None) -> Iterator[ResultFolder]:
    """Open a folder for results, or discard the results without a folder."""
    log_path = Path(os.devnull) if path is None else path / PARTIAL_LOG
    with clear_write_errors(log_path.parent):
        if path is not None:
            path.mkdir(parents=True, exist_ok=True)
        log = log_path.open("w", encoding="utf-8")
    try:
        yield ResultFolder(path, log)
    finally:
        with contextlib.suppress(OSError):  # a full disk
            log.close()
        if path is not None:
            log_path.unlink(missing_ok=True)


def _message_text(message: Message) -> str:
    road = road_values(message.data)
    content = _abbreviate(message.data) if road is None else road_words(road)
    return f"array {message.identity}, {message.layer}, message {message.stream}: {len(message.data)} bytes, {content}"


def _abbreviate(data: bytes) -> str:
    """Return the first 60 characters of a text, or of other data in hexadecimal."""
    try:
        text = data.decode()
    except UnicodeDecodeError:
        text = ""
    if not text or not all(character.isprintable() or character.isspace() for character in text):
        return data[:30].hex() + ("..." if len(data) > 30 else "")
    line = " ".join(text.split())
    return f"'{line}'" if len(line) <= 60 else f"'{line[:57]}...'"


def _show(outcome: Outcome, output: Path | None) -> None:
    """Print the results."""
    report, reception = outcome.report, outcome.reception
    detections = counted(report["detections"], "detection")
    frames, reading_s = report["frames"], report["reading_seconds"]
    receiving_s = max(report["seconds"] - reading_s, 1e-3)
    times = f"film {reading_s:.1f} s, receiver {receiving_s:.1f} s ({frames / receiving_s:.0f} frames/s)"
    found = f"; {detections}" if report["arrays"] else ""
    console.say(f"{counted(frames, 'frame')} in {report['seconds']:.1f} s: {times}{found}")
    if report["dropped_candidates"] or report["dropped_blocks"]:
        candidates, blocks = report["dropped_candidates"], report["dropped_blocks"]
        console.say_prose(
            f"the search skipped {counted(candidates, 'candidate')} and {counted(blocks, 'block')} to limit the CPU "
            "time; set --region, or raise receive.detect.cpu_share"
        )
    if not report["arrays"]:
        cause = outcome.monitor.unseen or (f"{detections} without a decoded codeword" if report["detections"] else "")
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
    for name in outcome.messages:
        console.say(f"message {output}/{name}")
    for identity, layer, stream, received, size in reception.unfinished():
        missing = f"{size - received} missing: record until the array repeats the message"
        console.say(f"array {identity}, {layer}, message {stream}: {received} of {size} bytes, {missing}")
    if reception.errors is not None:
        _show_errors(reception.errors)


def _show_end(outcome: Outcome, source: FilmReader) -> None:
    """Print incomplete files, the diagnosis of a missing array, and notes on the source."""
    reception = outcome.reception
    for line in outcome.files.incomplete_lines(reception.files, reception.frames / source.rate_hz):
        console.say_prose(line)
    if outcome.findings is not None:
        for line in in_short(outcome.findings):
            console.say_prose(line)
        film = console.argument(Path(outcome.report["film"]))
        console.note(f"'heliograph probe {film} --output DIR' gives details, with pictures")
    if outcome.monitor.live is not None:
        outcome.monitor.show(has_array=bool(outcome.report["arrays"]))


def _array_text(array: dict[str, Any]) -> str:
    return (
        f"array {array['id']}: {counted(array['packets'], 'packet')}, "
        f"frames {array['first_frame']} to {array['last_frame']}, "
        f"{array['first_distance_m']:.1f} m to {array['last_distance_m']:.1f} m away"
    )


def _show_errors(errors: ErrorCounter) -> None:
    console.say("distance      bit error rate of bits, codewords wrong/sent: high, middle, low")
    for start, layers in errors.bins().items():
        cells = "   ".join(
            f"{counts.decoded_bits.text():>9} of {counts.decoded_bits.trials:<7d} "
            f"{counts.words.errors:3d}/{counts.words.trials:<3d}"
            for counts in layers.values()
        )
        console.say(f"{start:5.0f}-{start + BIN_M:<4.0f} m  {cells}")
    console.say(f"packets that were not sent: {errors.false_packets}")
    if errors.uncertain_packets:
        console.say(f"packets of uncertain identity, no codeword decoded: {errors.uncertain_packets}")
    console.say(f"accepted codewords that were not sent: {errors.false_codewords}")


@dataclass(frozen=True, slots=True)
class FilmWork:
    """Film to receive in a worker process."""

    # Name in the results
    film: str
    path: Path
    options: ReceiveOptions

    def made_of(self) -> Row:
        """Return the origin of the results: equal origins have equal results."""
        options = self.options.settings
        with contextlib.suppress(OSError):
            stats = [file.stat() for file in _files_of(self.path)]
            file = options.settings_file
            toml = "" if file is None else file.read_text(encoding="utf-8", errors="replace")
            return {
                "film": [[stat.st_size, stat.st_mtime_ns] for stat in stats],
                "options": [asdict(self.options.film), options.preset, toml, list(options.assignments or ())],
                "version": __version__,
            }
        return {}


def _files_of(film: Path) -> list[Path]:
    """Return the files of a film: pictures of a folder or pattern, header and frames, or a single file."""
    if film.is_dir():
        return sorted(film.iterdir())
    if is_pattern(film):
        return sorted(film.parent.glob(f"*{glob.escape(film.suffix)}"))
    has_header = film.suffix.lower() in (".mraw", ".cih", ".cihx")
    return sorted(film.parent.glob(f"{glob.escape(film.stem)}.*")) if has_header else [film]


def films_of(paths: Sequence[Path]) -> tuple[list[Path], list[str]]:
    """Return the films of files and folders, and warnings about ignored content of folders."""
    found = [_films_of_folder(path) for path in paths]
    return [film for films, _ in found for film in films], [warning for _, warning in found if warning]


def is_many(paths: Sequence[Path]) -> bool:
    """Return True for several films or a folder of films."""
    return len(paths) > 1 or films_of(paths)[0] != [*paths]


def _films_of_folder(path: Path) -> tuple[Sequence[Path], str]:
    """Return the films of a folder, and a warning about ignored content.

    Films are files, TIFF stacks and folders of pictures. A folder of pictures and any other path is a film itself.
    """
    try:
        if not path.is_dir():
            return [path], ""
        entries = sorted(entry for entry in path.iterdir() if not entry.name.startswith("."))
        folders = [entry for entry in entries if entry.is_dir()]
        picture_folders = [
            folder for folder in folders if any(file.suffix.lower() in PICTURE_SUFFIXES for file in folder.iterdir())
        ]
    except OSError as error:
        raise MediaError(f"cannot read {path}: {error.strerror}") from None
    files = [entry for entry in entries if entry not in folders]
    films = [file for file in files if file.suffix.lower() in FILMS]
    pictures = [file for file in files if file.suffix.lower() in PICTURE_SUFFIXES]
    tiffs = [file for file in pictures if file.suffix.lower() in tiff.SUFFIXES]
    # the first file decides: opening each of a thousand pages takes too long
    stacks = tiffs if tiffs and tiff.is_stack(tiffs[0]) else []
    films += stacks
    if films or not pictures:
        films += picture_folders
    ignored = {"picture": len(pictures) - len(stacks), "folder": len(folders) - len(picture_folders)}
    listed = " and ".join(counted(count, kind) for kind, count in ignored.items() if count)
    remedy = "in this folder of films; put the pictures of each recording into a folder"
    return sorted(films) or [path], f"{path}: ignoring {listed} {remedy}" if films and listed else ""


def run_many(paths: Sequence[Path], options: ReceiveOptions, crew_options: WorkerOptions) -> list[Row]:
    """Receive films in worker processes or on a Dask cluster; a broken film does not stop the others."""
    if cameras := [path for path in paths if is_camera(path)]:
        raise MediaError(f"{cameras[0]} is a live camera: receive it separately, without --workers and --scheduler")
    films, warnings = films_of(paths)
    # other machines have other working directories
    base = Path.cwd() if crew_options.scheduler is not None else Path()
    works = [FilmWork(str(film), base / film, options.for_film(film, base)) for film in films]
    (name, count), *_ = Counter(film.name for film in films).most_common(1)
    if options.results.output is not None and count > 1:
        raise MediaError(
            f"several films have the name {name}, and share a folder for results: receive the films separately"
        )
    for text in filter(None, (*warnings, fewer_workers(crew_options.workers))):
        console.complain(text)
    rows = {work.film: row for work in works if (row := _stored_row(work)) is not None}
    for row in rows.values():
        console.say_json(row)
    remaining = [work for work in works if work.film not in rows]
    try:
        with (
            contextlib.closing(open_workers(crew_options.workers, crew_options.scheduler)) as crew,
            console.progress("films", len(works)) as advance,
        ):
            advance(len(rows))
            for row in _receive_all(remaining, crew):
                rows[row["film"]] = row
                console.say_json(row)
                advance(len(rows))
    except KeyboardInterrupt:
        for work in remaining:
            if (folder := work.options.results.output) is not None:  # the interrupted worker has left a partial log
                (folder / PARTIAL_LOG).unlink(missing_ok=True)
        hint = (
            "the same command continues" if options.results.output else "with --output the same command would continue"
        )
        console.exit_interrupted(f"interrupted after {len(rows)} of {len(works)} films; {hint}")
    complete, incomplete = join(options.results.files) if options.results.files else ([], [])
    for line in [*(f"{path} is complete, from several films" for path in complete), *incomplete]:
        console.complain(line)
    if broken := sum("error" in row for row in rows.values()):
        raise MediaError(f"{broken} of {len(works)} films could not be read to the end; see the error lines")
    folders = [work.options.results.output for work in works]
    if lost := sum(folder is not None and not (folder / "summary.json").exists() for folder in folders):
        raise MediaError(
            f"the results of {lost} of {len(works)} films are not in {options.results.output}: the workers wrote them "
            "elsewhere; use a folder that all machines share, or leave out --scheduler"
        )
    return list(rows.values())


def receive_one(work: FilmWork) -> Row:
    """Receive a film; errors become part of the row."""
    row: Row = {"film": work.film}
    cv2.setNumThreads(1)
    try:
        with open_film(work.path, **work.options.film.keywords()) as source:
            receive_source(source, row, work.options, origin=work.made_of())
    except (HeliographError, OSError, MemoryError) as error:
        row["error"] = console.error_line(error)
    return row


def _receive_all(works: Sequence[FilmWork], crew: Workers) -> Iterator[Row]:
    """Yield rows in the order of completion; replace lost workers, for example after a lack of memory."""
    waiting, running = list(works), dict[Future[Row], FilmWork]()
    while waiting or running:
        while waiting and len(running) < crew.slots:
            work = waiting.pop(0)
            running[crew.submit(receive_one, work)] = work
        completed, _ = wait(running, return_when=FIRST_COMPLETED)
        if any(isinstance(future.exception(), BrokenExecutor) for future in completed):
            # any of the films may have broken the pool: receive each in a separate pool
            lost = list(running.values())
            running.clear()
            crew.restart()
            for work in lost:
                future = crew.submit(receive_one, work)
                yield _row_of(future, work)
                if isinstance(future.exception(), BrokenExecutor):
                    crew.restart()
            continue
        for future in completed:
            work = running.pop(future)
            yield _row_of(future, work)


def _row_of(future: Future[Row], work: FilmWork) -> Row:
    try:
        return future.result()
    except BrokenExecutor:
        return {"film": work.film, "error": "the worker process ended; the memory may be too small"}
    except CancelledError:
        raise HeliographError("the connection to the Dask scheduler was lost; the results so far are kept") from None
    except Exception as error:  # such as a worker with another version of Heliograph
        text = f"its worker failed with {type(error).__name__}: {' '.join(str(error).split())}"
        return {"film": work.film, "error": text}


def _stored_row(work: FilmWork) -> Row | None:
    """Return the result of an earlier run with the same film and options."""
    folder = work.options.results.output
    if folder is None:
        return None
    with contextlib.suppress(OSError, ValueError, AttributeError):
        row = json.loads((folder / "summary.json").read_bytes())
        if row.pop("made_of") == work.made_of() != {} and "error" not in row:
            return {**row, "film": work.film, "kept": True}
    return None
