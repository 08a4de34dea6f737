"""Keeps what was read from files, so that they are read once: a SQLite file in the user's cache folder."""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

_VERSION = 2
"""Of what is kept of a file; an index of another version is made again."""
_TABLE = "CREATE TABLE IF NOT EXISTS files (path BLOB PRIMARY KEY, size INT, mtime_ns INT, facts TEXT)"

Stamp = tuple[int, int]
"""Size [bytes] and time of the last change [ns] of a file: what was read is true while both stay."""


def index_file() -> Path:
    """The index of this user: `$XDG_CACHE_HOME/eldir/runs.sqlite`, or below `~/.cache`."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "eldir" / "runs.sqlite"


class Index:
    """What was read from files, by path. An index that is damaged, foreign or of another version is made
    again; where none can be kept, it lives in memory for this run only."""

    def __init__(self, path: Path):
        self._path = path

    def __enter__(self) -> Index:
        self._store = self._open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._store.close()

    def _open(self) -> sqlite3.Connection:
        for _ in range(2):
            try:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                store = sqlite3.connect(self._path, timeout=5.0)
                if store.execute("PRAGMA user_version").fetchone()[0] not in (0, _VERSION):
                    raise sqlite3.DatabaseError("another version")
                store.execute(_TABLE)
                store.execute(f"PRAGMA user_version = {_VERSION}")
                store.execute("SELECT size, mtime_ns, facts FROM files LIMIT 1").fetchall()
                store.commit()
                return store
            except sqlite3.OperationalError:
                break  # no place, no right, or another process holds it for long
            except (sqlite3.DatabaseError, OSError):
                try:
                    self._path.unlink(missing_ok=True)
                except OSError:
                    break
        store = sqlite3.connect(":memory:")
        store.execute(_TABLE)
        return store

    def below(self, folder: str) -> dict[str, tuple[Stamp, dict[str, Any]]]:
        """Stamp and facts of every file below a folder that was read before, by path."""
        start = os.fsencode(os.path.join(folder, ""))  # names as the disk has them, which need not be UTF-8
        rows = self._store.execute(
            "SELECT path, size, mtime_ns, facts FROM files WHERE path >= ? AND path < ?",
            (start, start[:-1] + bytes([ord(os.sep) + 1])),
        )
        kept = rows.fetchall()
        facts = json.loads(f"[{','.join(row[3] for row in kept)}]")  # at once: ten thousand are quicker so
        return {os.fsdecode(row[0]): ((row[1], row[2]), said) for row, said in zip(kept, facts, strict=True)}

    def keep(self, read: Mapping[str, tuple[Stamp, dict[str, Any]]], gone: Iterable[str]) -> None:
        """Keep what was read from files, and forget files that are gone. Nothing is kept on a full disk."""
        try:
            with self._store:
                self._store.executemany(
                    "DELETE FROM files WHERE path = ?", [(os.fsencode(path),) for path in gone]
                )
                self._store.executemany(
                    "INSERT OR REPLACE INTO files VALUES (?, ?, ?, ?)",
                    [(os.fsencode(path), *stamp, json.dumps(facts)) for path, (stamp, facts) in read.items()],
                )
        except sqlite3.Error:
            pass
