"""Results of sweeps in one SQLite file: a row per block, so that nothing done is lost or done again.

Rows are keyed by all that a block depends on (see `Point.key`). A transaction a block: whatever is killed, and when,
the file holds whole blocks. Several sweeps may write to one file at a time.
"""

import contextlib
import json
import sqlite3
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from heliograph.base.config import to_mapping
from heliograph.base.errors import MediaError
from heliograph.measure.counts import MOST_NUMBER, BlockCounts
from heliograph.sweeps.points import Point, build

NAME = "results.sqlite"

FORMAT = 1
"""Number of the tables' form, in the file's user_version."""

_TABLES = """
CREATE TABLE IF NOT EXISTS points (
    key TEXT PRIMARY KEY, version TEXT NOT NULL, seed INTEGER NOT NULL,
    choice TEXT NOT NULL, settings TEXT NOT NULL, recordings TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS blocks (
    key TEXT NOT NULL, block INTEGER NOT NULL, counts TEXT NOT NULL, seconds REAL NOT NULL,
    computed INTEGER NOT NULL DEFAULT 1, PRIMARY KEY (key, block)) WITHOUT ROWID;
"""

_ADD = """
INSERT INTO blocks (key, block, counts, seconds) VALUES (?, ?, ?, ?)
ON CONFLICT (key, block) DO UPDATE SET computed = computed + 1
"""


class Store:
    """The file of results."""

    def __init__(self, folder: Path | None = None):
        self.path = folder / NAME if folder else None
        with self._clear():
            if folder:
                folder.mkdir(parents=True, exist_ok=True)
            # how long to wait for another sweep's transaction
            self._db = sqlite3.connect(self.path or ":memory:", timeout=60.0, isolation_level=None)
            try:
                self._open()
            except BaseException:  # Ctrl-C too must not leave the file open
                self._db.close()
                raise

    def _open(self) -> None:
        self._db.execute("PRAGMA journal_mode = WAL")
        self._db.execute("PRAGMA synchronous = NORMAL")
        (found,) = self._db.execute("PRAGMA user_version").fetchone()
        (tables,) = self._db.execute("SELECT count(*) FROM sqlite_master").fetchone()
        if found not in (0, FORMAT) or (not found and tables):
            raise MediaError(f"{self.path} holds no results of this version of heliograph; choose another folder")
        with self._transaction():
            for statement in _TABLES.split(";"):
                self._db.execute(statement)
            self._db.execute(f"PRAGMA user_version = {FORMAT}")

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    def note(self, point: Point) -> None:
        """Keep the settings of a point."""
        about = (
            point.key,
            build(),
            point.seed,
            json.dumps(dict(point.choice)),
            json.dumps(to_mapping(point.settings)),
            json.dumps({name: [one.path, one.digest] for name, one in point.recordings.items()}),
        )
        with self._clear(), self._transaction():
            self._db.execute("INSERT OR IGNORE INTO points VALUES (?, ?, ?, ?, ?, ?)", about)

    def add(self, point: Point, block: int, counts: BlockCounts, seconds: float) -> None:
        """Keep a block; where another sweep was faster, its row stays."""
        row = (point.key, block, json.dumps(counts.to_plain()), seconds)
        with self._clear(), self._transaction():
            self._db.execute(_ADD, row)

    def blocks(self, point: Point, first: int = 0) -> Mapping[int, tuple[BlockCounts, float]]:
        """Counts and computing time in s of a point's blocks, by number."""
        question = "SELECT block, counts, seconds FROM blocks WHERE key = ? AND block >= ? ORDER BY block"
        with self._clear():
            rows = self._db.execute(question, (point.key, first)).fetchall()
        return {block: self._counted(point, block, counts, seconds) for block, counts, seconds in rows}

    def _counted(self, point: Point, block: Any, counts: Any, seconds: Any) -> tuple[BlockCounts, float]:
        """A row's values; a MediaError where they were altered or damaged."""
        try:
            if not isinstance(block, int):
                raise ValueError("its number is no whole number")
            if not isinstance(seconds, (int, float)) or not 0 <= seconds < MOST_NUMBER:
                raise ValueError("its computing time is no number from 0")
            if not isinstance(counts, str):
                raise ValueError("its counts are no text")
            return BlockCounts.from_plain(json.loads(counts)), float(seconds)
        except (ValueError, RecursionError) as error:
            reason = "its counts are no JSON" if isinstance(error, (json.JSONDecodeError, RecursionError)) else error
            raise MediaError(
                f"{self.path or 'the store'} is damaged in block {str(block)[:20]} of {point.text}: {reason}; move the "
                "file away to count anew, or choose another folder"
            ) from None

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[None]:
        self._db.execute("BEGIN IMMEDIATE")
        try:
            yield
        except BaseException:  # Ctrl-C too must not leave half a block
            self._db.execute("ROLLBACK")
            raise
        self._db.execute("COMMIT")

    @contextlib.contextmanager
    def _clear(self) -> Iterator[None]:
        """Turn errors of SQLite and of the system into one line."""
        try:
            yield
        except (sqlite3.Error, OSError, ValueError, TypeError, KeyError) as error:
            if isinstance(error, MediaError):
                raise
            reason = getattr(error, "strerror", None) or error
            raise MediaError(f"cannot use {self.path or 'the store'}: {reason}; choose another folder") from None
