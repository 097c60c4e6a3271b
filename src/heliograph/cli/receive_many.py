"""Reception of many films in parallel, with a JSON line for each; complete films are not received again."""

import contextlib
import glob
import json
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2

from heliograph import __version__
from heliograph.base.errors import HeliographError, MediaError
from heliograph.base.words import counted
from heliograph.cli import console
from heliograph.cli.files import FileOutput, join
from heliograph.cli.live import EventOutput, FilmMonitor
from heliograph.cli.options import EventOptions, ReceiveOptions, WorkerOptions
from heliograph.cli.receive import (
    PARTIAL_LOG,
    ResultFolder,
    exit_without_array,
    is_unexplained,
    probe_unread,
    receive_packets,
)
from heliograph.link.truth import signal_of
from heliograph.measure.reception import Reception
from heliograph.media import open_film, tiff
from heliograph.media.images import PICTURE_SUFFIXES, is_pattern
from heliograph.media.live.reader import is_camera
from heliograph.sweeps.executors import Workers, fewer_workers, open_workers

FILMS = frozenset(
    f".{name}"
    for name in (
        "mkv", "nut", "mp4", "mov", "m4v", "webm", "avi", "y4m", "ts", "m2ts", "wmv", "flv", "h264", "h265", "hevc",
        "h5", "hdf5", "mat", "mraw", "cine", "npy",
    )
)  # fmt: skip
"""Suffixes of films in a folder; the pictures of a folder are the frames of a film."""

SUMMARY = "summary.json"

Row = dict[str, Any]
"""Result of a film."""


@dataclass(frozen=True, slots=True)
class FilmWork:
    """Film to receive in a worker process."""

    # Name in the results
    film: str
    path: Path
    options: ReceiveOptions

    @property
    def folder(self) -> Path | None:
        """Folder of the results."""
        output = self.options.results.output
        return None if output is None else output / self.path.name

    @property
    def files_folder(self) -> Path | None:
        """Folder of received files."""
        return self.options.results.files or (None if self.folder is None else self.folder / "files")

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
    films, warnings = list[Path](), list[str]()
    for path in paths:
        films_here, warning = _films_of_folder(path)
        films += films_here or [path]
        warnings += [warning] if warning else []
    return films, warnings


def is_many(paths: Sequence[Path]) -> bool:
    """Return True for several films or a folder of films."""
    return len(paths) > 1 or any(_films_of_folder(path)[0] for path in paths)


def run_many(paths: Sequence[Path], options: ReceiveOptions, crew_options: WorkerOptions) -> None:
    """Receive films in worker processes or on a Dask cluster; a broken film does not stop the others."""
    options.settings.load()  # reports invalid settings once
    if cameras := [path for path in paths if is_camera(path)]:
        raise MediaError(f"{cameras[0]} is a live camera: receive it separately, without --workers and --scheduler")
    films, warnings = films_of(paths)
    # other machines have other working directories
    base = Path.cwd() if crew_options.scheduler is not None else Path()
    works = [FilmWork(str(film), base / film, options.relative_to(base)) for film in films]
    _check_names(works)
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
        for folder in (work.folder for work in remaining if work.folder is not None):
            # the interrupted worker has left a partial log
            (folder / PARTIAL_LOG).unlink(missing_ok=True)
        hint = (
            "the same command continues" if options.results.output else "with --output the same command would continue"
        )
        console.exit_interrupted(f"interrupted after {len(rows)} of {len(works)} films; {hint}")
    complete, incomplete = join(options.results.files) if options.results.files else ([], [])
    for line in [*(f"{path} is complete, from several films" for path in complete), *incomplete]:
        console.complain(line)
    faults = list[str]()
    if broken := sum("error" in row for row in rows.values()):
        faults.append(f"{broken} of {len(works)} films could not be read to the end; see the error lines")
    if lost := sum(not _is_written(work, rows[work.film]) for work in works):
        place = " and ".join(str(path) for path in (options.results.output, options.results.files) if path is not None)
        faults.append(
            f"the results of {lost} of {len(works)} films are not in {place}: the workers wrote them elsewhere; use a "
            "folder that all machines share, or leave out --scheduler"
        )
    if faults:
        raise MediaError("; ".join(faults))
    exit_without_array(*rows.values())


def receive_one(work: FilmWork) -> Row:
    """Receive a film; errors become part of the row."""
    cv2.setNumThreads(1)
    try:
        options = work.options.settings
        settings, base = options.load(), options.load_preset()
        reception, start_s, made_of = Reception(), time.perf_counter(), work.made_of()
        files = FileOutput(work.files_folder, is_quiet=True)
        files.begin(reception.files)
        with open_film(work.path, **work.options.film.keywords()) as source:
            signal, departure = signal_of(source, base.signal, options.signal_changes())
            with ResultFolder(work.folder) as folder, EventOutput(EventOptions()) as events:
                monitor = FilmMonitor(source, is_quiet=True)
                ending = receive_packets(monitor, signal, settings, reception, folder, events, files)
                row = {"film": work.film, **reception.report(time.perf_counter() - start_s)}
                row["messages"] = folder.messages
                if departure:
                    row["departure"] = departure
                if is_unexplained(row, ending):
                    probe_unread(source, signal, settings, row, is_quiet=True)
                if ending.error:
                    row["error"] = _one_line(ending.error)
                folder.finish({**row, "made_of": made_of})
                files.finish(reception.files)
        if ending.is_interrupted:
            raise KeyboardInterrupt
    except (HeliographError, OSError, MemoryError) as error:
        return {"film": work.film, "error": _one_line(console.error_text(error))}
    else:
        return row


def _films_of_folder(path: Path) -> tuple[tuple[Path, ...], str]:
    """Return the films of a folder, and a warning about ignored content; no films for other paths.

    Films are files, TIFF stacks and folders of pictures. A folder of pictures is a film itself.
    """
    try:
        if not path.is_dir():
            return (), ""
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
    films += [*stacks, *([] if pictures and not films and not stacks else picture_folders)]
    ignored = [
        counted(count, kind)
        for count, kind in (
            (len(pictures) - len(stacks), "picture"), (len(folders) - len(picture_folders), "folder")
        )
        if count
    ]  # fmt: skip
    if not films or not ignored:
        return tuple(sorted(films)), ""
    return tuple(sorted(films)), (
        f"{path}: ignoring {' and '.join(ignored)} in this folder of films; put the pictures of each recording into a "
        "folder"
    )


def _check_names(works: Iterable[FilmWork]) -> None:
    folders = Counter(work.folder for work in works if work.folder is not None)
    repeated = [folder.name for folder, count in folders.items() if count > 1]
    if repeated:
        raise MediaError(
            f"several films have the name {repeated[0]}, and share a folder for results: receive the films separately"
        )


def _stored_row(work: FilmWork) -> Row | None:
    """Return the result of an earlier run with the same film and options."""
    if work.folder is None:
        return None
    with contextlib.suppress(OSError, ValueError, AttributeError):
        row = json.loads((work.folder / SUMMARY).read_bytes())
        if row.pop("made_of") == work.made_of() != {} and "error" not in row:
            return {**row, "film": work.film, "kept": True}
    return None


def _is_written(work: FilmWork, row: Row) -> bool:
    """Return True if the results of a worker are in the folders of this machine."""
    if "error" in row or "kept" in row:
        return True
    folder, files_folder = work.folder, work.files_folder
    with contextlib.suppress(OSError, ValueError, AttributeError):
        if folder is not None:
            names = {path.name for path in folder.iterdir()}  # refreshes the cache of network file systems
            summary = json.loads((folder / SUMMARY).read_bytes())
            if summary.get("seconds") != row["seconds"] or not names.issuperset(row["messages"]):
                return False
        has_symbols = any(file["symbols"] for file in row["files"])
        return files_folder is None or not has_symbols or any(files_folder.iterdir())
    return False


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
        row = future.result()
    except BrokenExecutor:
        return {"film": work.film, "error": "the worker process ended; the memory may be too small"}
    except CancelledError:
        raise HeliographError("the connection to the Dask scheduler was lost; the results so far are kept") from None
    except Exception as error:  # such as a worker with another version of Heliograph
        text = _one_line(str(error)) or type(error).__name__
        return {"film": work.film, "error": f"its worker failed with {type(error).__name__}: {text}"}
    if row.get("error", "").startswith("there is no file") and work.path.exists():  # on this machine
        row["error"] = f"the worker has no file {work.path}: all machines need this folder under the same name"
    return row


def _one_line(text: str) -> str:
    return " ".join(text.split())
