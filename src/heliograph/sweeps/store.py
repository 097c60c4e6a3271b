"""Results of sweeps in a SQLite file, a row and a transaction per block.

`Point.key` identifies the inputs of a block. Concurrent sweeps may share a file.
"""

import contextlib
import json
import sqlite3
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from heliograph.base.errors import MediaError
from heliograph.measure.counts import MAX_NUMBER, BlockCounts
from heliograph.sweeps.points import Point

NAME = "results.sqlite"

FORMAT = 1  # version of the table, the user_version of the file

_TABLE = """
CREATE TABLE IF NOT EXISTS blocks (
    key TEXT NOT NULL, block INTEGER NOT NULL, counts TEXT NOT NULL, seconds REAL NOT NULL,
    computed INTEGER NOT NULL DEFAULT 1, PRIMARY KEY (key, block)) WITHOUT ROWID
"""


class Store:
    """File of results; in memory by default."""

    def __init__(self, folder: Path | None = None):
        self.path = folder / NAME if folder else None
        with self._media_errors():
            if folder:
                folder.mkdir(parents=True, exist_ok=True)
            self._db = sqlite3.connect(self.path or ":memory:", timeout=60.0, isolation_level=None)
            with contextlib.ExitStack() as undo:
                undo.callback(self._db.close)
                self._create_table()
                undo.pop_all()

    def _create_table(self) -> None:
        self._db.execute("PRAGMA journal_mode = WAL")
        self._db.execute("PRAGMA synchronous = NORMAL")
        with self._db:  # a transaction
            self._db.execute("BEGIN IMMEDIATE")
            (found,) = self._db.execute("PRAGMA user_version").fetchone()
            (tables,) = self._db.execute("SELECT count(*) FROM sqlite_master").fetchone()
            if found not in (0, FORMAT) or (not found and tables):
                raise MediaError(f"{self.path} holds no results of this version of heliograph; choose another folder")
            self._db.execute(_TABLE)
            self._db.execute(f"PRAGMA user_version = {FORMAT}")

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    def add(self, point: Point, block: int, counts: BlockCounts, seconds: float) -> None:
        """Store a block; an existing row of another sweep is kept."""
        row = (point.key, block, json.dumps(counts.to_plain()), seconds)
        with self._media_errors():
            self._db.execute(
                "INSERT INTO blocks (key, block, counts, seconds) VALUES (?, ?, ?, ?) "
                "ON CONFLICT (key, block) DO UPDATE SET computed = computed + 1",
                row,
            )

    def blocks(self, point: Point, first: int = 0) -> Mapping[int, tuple[BlockCounts, float]]:
        """Return counts and computing time in s of the blocks of a point by number."""
        query = "SELECT block, counts, seconds FROM blocks WHERE key = ? AND block >= ? ORDER BY block"
        with self._media_errors():
            rows = self._db.execute(query, (point.key, first)).fetchall()
        return {block: self._parse(point, block, counts, seconds) for block, counts, seconds in rows}

    def _parse(self, point: Point, block: Any, counts: Any, seconds: Any) -> tuple[BlockCounts, float]:
        """Return the values of a row; raise MediaError for invalid values."""
        try:
            valid = isinstance(block, int) and isinstance(counts, str) and isinstance(seconds, (int, float))
            if not valid or not 0 <= seconds < MAX_NUMBER:
                raise ValueError("invalid block number, counts or computing time")
            return BlockCounts.from_plain(json.loads(counts)), float(seconds)
        except (ValueError, RecursionError) as error:
            reason = "the counts are no JSON" if isinstance(error, (json.JSONDecodeError, RecursionError)) else error
            raise MediaError(
                f"{self.path or 'the store'} is damaged in block {str(block)[:20]} of {point.text}: {reason}; move the "
                "file away to restart, or choose another folder"
            ) from None

    @contextlib.contextmanager
    def _media_errors(self) -> Iterator[None]:
        """Convert errors of SQLite and the system."""
        try:
            yield
        except MediaError:
            raise
        except (sqlite3.Error, OSError, ValueError, TypeError, KeyError) as error:
            reason = getattr(error, "strerror", None) or error
            raise MediaError(f"cannot use {self.path or 'the store'}: {reason}; choose another folder") from None
