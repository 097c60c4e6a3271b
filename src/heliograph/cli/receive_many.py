"""heliograph receive, of many films: a worker for each, a line of JSON for each, and what is done is not done again."""

import contextlib
import glob
import json
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from heliograph import __version__
from heliograph.base.errors import HeliographError, MediaError
from heliograph.base.words import counted
from heliograph.cli import console, options
from heliograph.cli.files import Files, join
from heliograph.cli.receive import FILES, PARTIAL_LOG

FILMS = (
    ".mkv",
    ".nut",
    ".mp4",
    ".mov",
    ".m4v",
    ".webm",
    ".avi",
    ".y4m",
    ".ts",
    ".m2ts",
    ".wmv",
    ".flv",
    ".h264",
    ".h265",
    ".hevc",
    ".h5",
    ".hdf5",
    ".mat",
    ".mraw",
    ".cine",
    ".npy",
)
"""Suffixes of files that are taken for films in a folder; pictures in it are the frames of one film."""

SUMMARY = "summary.json"


@dataclass(frozen=True, slots=True)
class FilmWork:
    """A film to be received: the options of the command, as they were given; it can be pickled."""

    film: str
    seen: options.FilmOptions
    preset: str
    file: Path | None
    assignments: tuple[str, ...]
    output: Path | None
    files: Path | None = None
    # Folder in which the command runs, for workers that run in another one; None for workers of this command
    here: Path | None = None

    @property
    def path(self) -> Path:
        """The film, or the name of a camera."""
        return self._at(Path(self.film))

    @property
    def settings(self) -> Path | None:
        """The file of settings."""
        return None if self.file is None else self._at(self.file)

    @property
    def folder(self) -> Path | None:
        """Where its results go."""
        return None if self.output is None else self._at(self.output) / Path(self.film).name

    @property
    def files_folder(self) -> Path | None:
        """Where files from the air go."""
        if self.files is not None:
            return self._at(self.files)
        return None if self.folder is None else self.folder / FILES

    def _at(self, path: Path) -> Path:
        return path if self.here is None else self.here / path

    def made_of(self) -> dict[str, Any]:
        """What its results follow from, as plain values: they hold as long as it stays the same."""
        with contextlib.suppress(OSError):
            found = [file.stat() for file in _files_of(self.path)]
            settings = "" if self.settings is None else self.settings.read_text(encoding="utf-8", errors="replace")
            return {
                "film": [[one.st_size, one.st_mtime_ns] for one in found],
                "options": [asdict(self.seen), self.preset, settings, list(self.assignments)],
                "version": __version__,
            }
        return {}


def _files_of(film: Path) -> list[Path]:
    """The files that a film may be made of: pictures of a folder or pattern, a header beside its frames, or itself."""
    from heliograph.media.images import is_pattern

    if film.is_dir():
        return sorted(film.iterdir())
    if is_pattern(film):
        return sorted(film.parent.glob(f"*{glob.escape(film.suffix)}"))
    headed = film.suffix.lower() in (".mraw", ".cih", ".cihx")
    return sorted(film.parent.glob(f"{glob.escape(film.stem)}.*")) if headed else [film]


@dataclass(frozen=True, slots=True)
class Folder:
    """What a folder of films holds."""

    # Its films in the order of their names: files, TIFF stacks, and folders of pictures
    films: tuple[Path, ...]
    # What is left out of it, in words; empty for nothing
    left_out: str


def films_of(given: Sequence[Path]) -> tuple[list[Path], list[str]]:
    """The films named, and what is left out of folders: files as they are, of a folder of films its films."""
    films, left_out = list[Path](), list[str]()
    for path in given:
        found = _looked_into(path)
        films += found.films or [path]
        left_out += [found.left_out] if found.left_out else []
    return films, left_out


def is_many(given: Sequence[Path]) -> bool:
    """Whether what is named is more than one film, or a folder of films."""
    return len(given) > 1 or any(_looked_into(path).films for path in given)


def run_many(
    given: Sequence[Path],
    seen: options.FilmOptions,
    preset: str,
    file: Path | None,
    assignments: Sequence[str],
    output: Path | None,
    crew_of: tuple[int | None, str | None],
    files: Path | None = None,
) -> None:
    """Receive films, several at a time; a film that cannot be read stops no other.

    Workers are given by their number, None for one a core, or by the address of a Dask scheduler.
    """
    from heliograph.cli.probe import found_array
    from heliograph.media.live.reader import is_camera
    from heliograph.sweeps.executors import fewer_workers, open_workers

    options.settings_from(preset, file, list(assignments))  # what is wrong with them is said once
    if cameras := [film for film in given if is_camera(film)]:
        raise MediaError(f"{cameras[0]} is a live camera: receive it by itself, without --workers and --scheduler")
    films, left_out = films_of(given)
    workers, scheduler = crew_of
    here = Path.cwd() if scheduler is not None else None
    works = [FilmWork(str(film), seen, preset, file, tuple(assignments), output, files, here) for film in films]
    _check_names(works)
    for text in left_out:
        console.complain(text)
    if fewer := fewer_workers(workers):
        console.complain(fewer)
    rows = {work.film: kept for work in works if (kept := _kept(work)) is not None}
    for row in rows.values():
        console.say_json(row)
    left, interrupted = [work for work in works if work.film not in rows], False
    with contextlib.closing(open_workers(workers, scheduler)) as crew, console.progress("films", len(works)) as advance:
        advance(len(rows))
        try:
            for work, row in _received(left, crew):
                if work.here is not None and row.get("error", "").startswith("there is no file") and work.path.exists():
                    row["error"] = f"the worker has no file {work.path}: all machines need its folder, under one name"
                rows[row["film"]] = row
                console.say_json(row)
                advance(len(rows))
        except KeyboardInterrupt:
            interrupted = True
    if interrupted:
        for folder in (work.folder for work in left if work.folder is not None):
            # its worker was ended in the middle
            (folder / PARTIAL_LOG).unlink(missing_ok=True)
        again = "the same command goes on" if works[0].output else "with --output the same command would go on"
        console.complain(f"interrupted after {len(rows)} of {len(works)} films; {again}")
        sys.exit(console.INTERRUPTED)
    whole, lacking = join(files) if files else ([], [])
    for line in [*(f"{path} is whole, of several films" for path in whole), *lacking]:
        console.complain(line)
    faults = list[str]()
    if broken := sum("error" in row for row in rows.values()):
        faults.append(f"{broken} of {len(works)} films could not be read to the end; their lines say why")
    if lost := sum(not _is_written(work, rows[work.film]) for work in works):
        place = " and ".join(str(path) for path in (output, files) if path is not None)
        faults.append(
            f"the results of {lost} of {len(works)} films are not in {place}: the workers wrote them elsewhere; give a "
            "folder that all machines share, or leave out --scheduler"
        )
    if faults:
        raise MediaError("; ".join(faults))
    if not any(found_array(row) for row in rows.values()):
        sys.exit(console.NO_ARRAY)


def receive_one(work: FilmWork) -> dict[str, Any]:
    """Receive a film; what goes wrong with it is part of the result."""
    import cv2

    from heliograph.cli.live import News, Told, Watch
    from heliograph.cli.probe import why_unread
    from heliograph.cli.receive import Folder, finish_folder, read_film
    from heliograph.link.truth import signal_of
    from heliograph.measure.reception import Reception
    from heliograph.media import open_film

    cv2.setNumThreads(1)
    try:
        settings = options.settings_from(work.preset, work.settings, list(work.assignments))
        base = options.settings_from(work.preset, None, None)
        changes = options.signal_changes(work.settings, list(work.assignments))
        reception, began, made_of = Reception(), time.perf_counter(), work.made_of()
        kept = Files(work.files_folder, aloud=False)
        kept.begin(reception.files)
        with open_film(work.path, **work.seen.keywords()) as source:
            signal, departure = signal_of(source, base.signal, changes)
            with Folder(work.folder) as folder, News(Told()) as news:
                watch = Watch(source, None, None, aloud=False)
                ending = read_film(watch, signal, settings, reception, (folder, news, kept))
                report = {"film": work.film, **reception.report(time.perf_counter() - began)}
                report["messages"] = folder.messages
                if departure:
                    report["departure"] = departure
                why_unread(source, signal, settings, report, ending, quiet=True)
                if ending is not None:
                    report["error"] = _line(ending)
                ending = finish_folder(folder, {**report, "made_of": made_of}, watch) or ending
                ending = kept.finish(reception.files) or ending
        if isinstance(ending, KeyboardInterrupt):
            raise ending
    except (HeliographError, OSError, MemoryError) as error:
        return {"film": work.film, "error": _line(error)}
    else:
        return report


def _looked_into(path: Path) -> Folder:
    """What a folder of films holds; no films of a folder of pictures, which is a film itself, and of what is none."""
    from heliograph.media import tiff
    from heliograph.media.images import PICTURE_SUFFIXES

    try:
        if not path.is_dir():
            return Folder((), "")
        held = sorted(one for one in path.iterdir() if not one.name.startswith("."))
        folders = [one for one in held if one.is_dir()]
        pictured = [one for one in folders if any(each.suffix.lower() in PICTURE_SUFFIXES for each in one.iterdir())]
    except OSError as error:
        raise MediaError(f"cannot read {path}: {error.strerror}") from None
    files = [one for one in held if one.suffix.lower() in FILMS and one not in folders]
    pictures = [one for one in held if one.suffix.lower() in PICTURE_SUFFIXES and one not in folders]
    tiffs = [one for one in pictures if one.suffix.lower() in tiff.SUFFIXES]
    # stacks are all of them or none: a folder of a thousand pages is not opened page by page
    stacks = tiffs if tiffs and tiff.is_stack(tiffs[0]) else []
    films = (*files, *stacks, *(() if pictures and not files and not stacks else pictured))
    if not films:
        return Folder((), "")
    loose, others = len(pictures) - len(stacks), len(folders) - len(pictured)
    left = [counted(count, what) for count, what in ((loose, "picture"), (others, "folder")) if count]
    why = (
        f"{path}: {' and '.join(left)} beside the films left out; give each recording's pictures a folder of their own"
    )
    return Folder(tuple(sorted(films)), why if left else "")


def _check_names(works: Iterable[FilmWork]) -> None:
    names = Counter(work.folder for work in works if work.folder is not None)
    twice = [folder.name for folder, count in names.items() if count > 1]
    if twice:
        raise MediaError(
            f"several films have the name {twice[0]}, and one folder for their results: receive them apart"
        )


def _kept(work: FilmWork) -> dict[str, Any] | None:
    """The result of an earlier run of the same film and options; None if there is none."""
    if work.folder is None:
        return None
    with contextlib.suppress(OSError, ValueError, AttributeError):
        row = json.loads((work.folder / SUMMARY).read_bytes())
        if row.pop("made_of") == work.made_of() != {} and "error" not in row:
            return {**row, "film": work.film, "kept": True}
    return None


def _is_written(work: FilmWork, row: dict[str, Any]) -> bool:
    """Return True if the folders here have what a worker says that it wrote."""
    if "error" in row or "kept" in row:
        return True
    symbols = sum(file["symbols"] for file in row["files"])
    folder, files = work.folder, work.files_folder
    with contextlib.suppress(OSError, ValueError, AttributeError):
        if folder is not None:
            there = {path.name for path in folder.iterdir()}  # network file systems then look anew
            held = json.loads((folder / SUMMARY).read_bytes())
            if held.get("seconds") != row["seconds"] or not there.issuperset(row["messages"]):
                return False
        return files is None or not symbols or any(files.iterdir())
    return False


def _received(works: Sequence[FilmWork], crew: Any) -> Iterator[tuple[FilmWork, dict[str, Any]]]:
    """Works with their results as they come; a worker that is lost, for example without memory, is replaced."""
    waiting, flying = list(works), dict[Future[dict[str, Any]], FilmWork]()
    while waiting or flying:
        while waiting and len(flying) < crew.slots:
            work = waiting.pop(0)
            flying[crew.submit(receive_one, work)] = work
        ended, _ = wait(flying, return_when=FIRST_COMPLETED)
        if any(isinstance(future.exception(), BrokenExecutor) for future in ended):
            # which of them broke it is not known: each is given a pool of its own
            lost = list(flying.values())
            flying.clear()
            crew.restart()
            yield from ((work, _alone(work, crew)) for work in lost)
            continue
        for future in ended:
            work = flying.pop(future)
            yield work, _result(future, work)


def _alone(work: FilmWork, crew: Any) -> dict[str, Any]:
    future = crew.submit(receive_one, work)
    row = _result(future, work)
    if isinstance(future.exception(), BrokenExecutor):
        crew.restart()
    return row


def _result(future: "Future[dict[str, Any]]", work: FilmWork) -> dict[str, Any]:
    try:
        return future.result()
    except BrokenExecutor:
        return {"film": work.film, "error": "its worker process ended; there may be too little memory"}
    except CancelledError:
        raise HeliographError("the connection to the Dask scheduler was lost; the results so far are kept") from None
    except Exception as error:  # of a worker anywhere: no heliograph, another version
        return {"film": work.film, "error": f"its worker failed with {type(error).__name__}: {_line(error)}"}


def _line(error: BaseException) -> str:
    """The words of an error on one line."""
    return " ".join(str(error).split()) or type(error).__name__
