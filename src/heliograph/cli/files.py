"""Progress and storage of received files."""

from collections.abc import Iterator
from pathlib import Path

from heliograph.cli import console
from heliograph.link.file_store import FileStore, safe_name
from heliograph.signal.fountain.files import FileGatherer, FileKey, FileProgress


class FileOutput:
    """Progress of files during a reception, and storage of complete files."""

    def __init__(self, folder: Path | None, *, is_quiet: bool):
        self.store = FileStore(folder) if folder is not None else None
        self._is_quiet = is_quiet
        self._next_share: dict[FileKey, float] = {}
        self._initial_symbols: dict[FileKey, int] = {}
        self._complaints: set[tuple[FileKey, str]] = set()

    def begin(self, files: FileGatherer) -> None:
        """Continue with the symbols of earlier receptions."""
        for progress in self.store.begin(files) if self.store else ():
            if progress.whole is None:
                self._say(f"{_progress_text(progress)}, from earlier films")
            self._initial_symbols[progress.key] = progress.had
            self.update(progress)

    def update(self, progress: FileProgress) -> None:
        """Print the progress of a file every 10 %, and store a complete file."""
        key = progress.key
        if progress.reason and (key, progress.reason) not in self._complaints:
            self._complaints.add((key, progress.reason))
            console.complain(f"file {key}: {progress.reason}")
        share = progress.had / key.count
        if progress.whole is not None:
            size = len(progress.whole.data)
            if self.store:
                self._say(f"file {key} is complete: {self.store.keep(progress.whole, key)}, {size} bytes")
            else:
                name = safe_name(progress.whole.name)
                self._say(f"file {key} is complete: {name}, {size} bytes; --files DIR writes it")
        elif share >= self._next_share.get(key, 0.0):
            self._next_share[key] = share + 0.1
            self._say(_progress_text(progress))

    def finish(self, files: FileGatherer) -> None:
        """Store the symbols of incomplete files for later receptions."""
        if self.store:
            self.store.finish(files)

    def incomplete_lines(self, files: FileGatherer, seconds: float) -> Iterator[str]:
        """Yield a line for each incomplete file after a film of some seconds."""
        for progress in files.unfinished():
            new = progress.had - self._initial_symbols.get(progress.key, 0)
            yield incomplete_text(progress, seconds / new if new > 0 else None, is_stored=self.store is not None)

    def _say(self, text: str) -> None:
        if not self._is_quiet:
            console.say(text)


def _progress_text(progress: FileProgress) -> str:
    key = progress.key
    return f"file {key}: {progress.had} of {key.count} symbols ({100 * progress.had // key.count} %)"


def incomplete_text(progress: FileProgress, symbol_s: float | None, *, is_stored: bool) -> str:
    """Return the progress of an incomplete file, the number of missing symbols, and the remedy."""
    missing = max(progress.key.count - progress.had, 1)
    duration = f", about {missing * symbol_s:.1f} s" if symbol_s is not None else ""
    remedy = (
        "another film with the same --files DIR" if is_stored else "--files DIR, which keeps symbols for another film"
    )
    return f"{_progress_text(progress)}, {missing} missing: film longer{duration}, or use {remedy}"


def join(folder: Path) -> tuple[list[Path], list[str]]:
    """Join symbols of several films in a folder; return the complete files, and a line for each incomplete file."""
    store, files = FileStore(folder), FileGatherer()
    for progress in list(store.begin(files)):
        if progress.whole is not None:
            store.keep(progress.whole, progress.key)
    store.finish(files)
    return store.written, [incomplete_text(progress, None, is_stored=True) for progress in files.unfinished()]
