"""Files from the air while a film is received: how far they have come, and where they are written."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from heliograph.base.errors import MediaError
from heliograph.cli import console

if TYPE_CHECKING:
    from heliograph.signal.fountain.files import FileGatherer, FileKey, FileProgress


class Files:
    """Says how far files have come, and writes whole ones."""

    def __init__(self, folder: Path | None, aloud: bool):
        from heliograph.link.file_store import FileStore

        self.store: FileStore | None = FileStore(folder) if folder is not None else None
        self._aloud = aloud
        self._said: dict[FileKey, float] = {}
        self._before: dict[FileKey, int] = {}
        self._complained: set[tuple[FileKey, str]] = set()

    def begin(self, files: "FileGatherer") -> None:
        """Go on with what earlier passages left."""
        for progress in self.store.begin(files) if self.store else ():
            if self._aloud and progress.whole is None:
                console.say(f"{_words(progress)}, from before")
            self._before[progress.key] = progress.had
            self.took(progress)

    def took(self, progress: "FileProgress") -> None:
        """Say what is there of a file, and write it where it is whole."""
        key = progress.key
        if progress.reason and (key, progress.reason) not in self._complained:
            self._complained.add((key, progress.reason))
            console.complain(f"file {key}: {progress.reason}")
        part = progress.had / key.count
        if progress.whole is not None:
            self._whole(progress)
        elif self._aloud and part >= self._said.get(key, 0.0):
            # Fraction of a file after which its progress is said again. Chosen
            self._said[key] = part + 0.1
            console.say(_words(progress))

    def finish(self, files: "FileGatherer") -> MediaError | None:
        """Keep what is there of others for the next passage; a failure is returned: results are still to be shown."""
        try:
            if self.store:
                self.store.finish(files)
        except MediaError as error:
            return error
        return None

    def lacking(self, files: "FileGatherer", seconds: float) -> "Iterator[str]":
        """Say of each file that is not whole what is there, what is missing, and what helps.

        `seconds` is the length of the film.
        """
        for progress in files.unfinished():
            new = progress.had - self._before.get(progress.key, 0)
            yield lacking_words(progress, seconds / new if new > 0 else None, kept=self.store is not None)

    def _whole(self, progress: "FileProgress") -> None:
        from heliograph.link.file_store import safe_name

        assert progress.whole is not None
        name, size = safe_name(progress.whole.name), len(progress.whole.data)
        if self.store:
            path = self.store.keep(progress.whole, progress.key)
            if self._aloud:
                console.say(f"file {progress.key} is whole: {path}, {size} bytes")
        elif self._aloud:
            console.say(f"file {progress.key} is whole: {name}, {size} bytes; --files DIR writes it")


def _words(progress: "FileProgress") -> str:
    key = progress.key
    return f"file {key}: {progress.had} of {key.count} symbols ({100 * progress.had // key.count} %)"


def lacking_words(progress: "FileProgress", seconds_a_symbol: float | None, kept: bool) -> str:
    """Say what is there of a file that is not whole, what is missing, and what helps."""
    missing = max(progress.key.count - progress.had, 1)
    more = f", about {missing * seconds_a_symbol:.1f} s" if seconds_a_symbol is not None else ""
    again = "another film with the same --files DIR" if kept else "--files DIR, which keeps them for another film"
    return f"{_words(progress)}, {missing} missing: film longer{more}, or take {again}"


def join(folder: Path) -> tuple[list[Path], list[str]]:
    """Put together what several films have left of files in a folder.

    Return the files that are whole now, and a line for each that is not.
    """
    from heliograph.link.file_store import FileStore
    from heliograph.signal.fountain.files import FileGatherer

    store, files = FileStore(folder), FileGatherer()
    for progress in list(store.begin(files)):
        if progress.whole is not None:
            store.keep(progress.whole, progress.key)
    store.finish(files)
    return store.written, [lacking_words(progress, None, kept=True) for progress in files.unfinished()]
