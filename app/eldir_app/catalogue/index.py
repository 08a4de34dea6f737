"""A cache of what was read from files, so that each is read once: a SQLite file in the user's cache
folder."""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

_VERSION = 2
"""Of the cached values; an index of another version is rebuilt."""
_TABLE = "CREATE TABLE IF NOT EXISTS files (path BLOB PRIMARY KEY, size INT, mtime_ns INT, facts TEXT)"

Stamp = tuple[int, int]
"""Size [bytes] and time of the last change [ns] of a file: its facts are valid while both are the same."""


def index_file() -> Path:
    """The index of this user: `$XDG_CACHE_HOME/eldir/runs.sqlite`, or below `~/.cache`."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "eldir" / "runs.sqlite"


class Index:
    """Facts about files, by path. A damaged file, or one of another version, is rebuilt; where none can be
    written, the index is in memory."""

    def __init__(self, path: Path):
        self._path = path

    def __enter__(self) -> Index:
        self._database = self._open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._database.close()

    def _open(self) -> sqlite3.Connection:
        for _ in range(2):
            try:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                database = sqlite3.connect(self._path, timeout=5.0)
                if database.execute("PRAGMA user_version").fetchone()[0] not in (0, _VERSION):
                    raise sqlite3.DatabaseError("another version")
                database.execute(_TABLE)
                database.execute(f"PRAGMA user_version = {_VERSION}")
                database.execute("SELECT size, mtime_ns, facts FROM files LIMIT 1").fetchall()
                database.commit()
                return database
            except sqlite3.OperationalError:
                break  # disk full, no permission, or locked by another process for long
            except (sqlite3.DatabaseError, OSError):
                try:
                    self._path.unlink(missing_ok=True)
                except OSError:
                    break
        database = sqlite3.connect(":memory:")
        database.execute(_TABLE)
        return database

    def read(self, folder: str) -> dict[str, tuple[Stamp, dict[str, Any]]]:
        """Stamp and facts of every file below a folder that is in the index, by path."""
        start = os.fsencode(os.path.join(folder, ""))  # names on disk need not be UTF-8
        rows = self._database.execute(
            "SELECT path, size, mtime_ns, facts FROM files WHERE path >= ? AND path < ?",
            (start, start[:-1] + bytes([ord(os.sep) + 1])),
        )
        entries = rows.fetchall()
        facts = json.loads(f"[{','.join(row[3] for row in entries)}]")  # in one call: faster for ten thousand
        return {
            os.fsdecode(row[0]): ((row[1], row[2]), known) for row, known in zip(entries, facts, strict=True)
        }

    def update(self, read: Mapping[str, tuple[Stamp, dict[str, Any]]], deleted: Iterable[str]) -> None:
        """Save the facts of files, and forget deleted ones. Does nothing on a full disk."""
        try:
            with self._database:
                self._database.executemany(
                    "DELETE FROM files WHERE path = ?", [(os.fsencode(path),) for path in deleted]
                )
                self._database.executemany(
                    "INSERT OR REPLACE INTO files VALUES (?, ?, ?, ?)",
                    [(os.fsencode(path), *stamp, json.dumps(facts)) for path, (stamp, facts) in read.items()],
                )
        except sqlite3.Error:
            pass
