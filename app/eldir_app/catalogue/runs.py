"""Finds the logs below folders, with what reports and notes say about them.

Each file is read once: what it says is kept in a SQLite file in the user's cache folder.
"""

from __future__ import annotations

import json
import logging
import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from eldir.errors import EldirError, InputError, missing
from eldir_app.catalogue.facts import (
    NOTES_SUFFIX,
    LogFacts,
    Note,
    Notes,
    ReportedRun,
    notes_file,
    read_facts,
    read_notes,
    read_report,
)
from eldir_hardware.images.file_kind import require_log

_logger = logging.getLogger(__name__)

FORMAT = "eldir-runs/1"
_LOG_SUFFIX, _REPORT_NAME = ".mcap", "report.json"
_BATCH = 20  # files that are read before the index is written
_REPORT_DEPTH = 2  # levels below a single log's folder where its report is searched

Progress = Callable[[int, int], None]
"""Called with the number of files read so far, and of all files to read."""
_VERSION = 3
"""Of the cached values; an index of another version is rebuilt."""
_TABLE = "CREATE TABLE IF NOT EXISTS files (path BLOB PRIMARY KEY, size INT, mtime_ns INT, facts TEXT)"

Stamp = tuple[int, int]
"""Size [bytes] and time of the last change [ns] of a file: its facts are valid while both are the same."""


# Plain dataclasses: ten thousand records of pydantic would be slow.
@dataclass(frozen=True)
class _LogFile:
    """One log."""

    log: Path
    """Path of the log."""
    bytes: int
    """Size of the log [bytes]."""


@dataclass(frozen=True)
class CataloguedRun(LogFacts, _LogFile):  # in JSON, the fields of the last base come first
    """One log, with its report and its notes."""

    report: Path | None = None
    """Path of the newest report.json about the log; null if there is none."""
    reported: ReportedRun | None = None
    """What that report says of this log; null without a report."""
    tags: tuple[str, ...] = ()
    """Tags of the log."""
    notes: tuple[Note, ...] = ()
    """Notes on the log, the oldest first."""

    @property
    def expected(self) -> float | None:
        """Predicted walk [body lengths per five cycles]: that of the report, else that of the schedule."""
        return self.predicted if self.reported is None else self.reported.predicted

    @property
    def filmed(self) -> float | None:
        """Filmed walk [body lengths per five cycles], by the report."""
        return None if self.reported is None else self.reported.filmed

    @property
    def verdict(self) -> str:
        """The report's verdict; empty without a report."""
        return "" if self.reported is None else self.reported.verdict


@dataclass(frozen=True)
class Catalogue:
    """The runs that were found, in the order of their paths, and what could not be read."""

    runs: tuple[CataloguedRun, ...]
    problems: tuple[str, ...]


@dataclass(frozen=True)
class _Files:
    """Files below a folder, by path."""

    logs: dict[str, Stamp]
    reports: dict[str, Stamp]
    annotated: set[str]
    """Logs that have a file of notes."""


def find_runs(
    paths: Sequence[Path], index: Index, progress: Progress = lambda done, total: None
) -> Catalogue:
    """The runs below folders, and those of single logs. Facts are taken from the index, as long as size and
    time of a file are the same.

    Raises `InputError` for a path that does not exist, or is neither a folder nor a log.
    """
    runs: dict[str, CataloguedRun] = {}
    problems: list[str] = []
    for path in paths:
        if not path.exists():
            raise missing(path, "name a folder of logs, or a log")
        if path.is_dir():
            folder, files = path, _find_files(path, problems)
        elif path.suffix == _LOG_SUFFIX:
            folder, files = path.parent, _files_of_log(path, problems)
        else:
            require_log(path)
            raise InputError(f"{path} is neither a folder nor a log", expected="a folder, or a file *.mcap")
        facts = _read_new_files(folder, files, index, progress, forget=path.is_dir())
        for run in _assemble_runs(files, facts, problems):
            runs.setdefault(os.path.abspath(run.log), run)
    return Catalogue(tuple(runs.values()), tuple(problems))


def _files_of_log(log: Path, problems: list[str]) -> _Files:
    """A single log, with its notes and the reports near it."""
    status, path = log.stat(), str(log)
    nearby = _find_files(log.parent, problems, _REPORT_DEPTH)
    annotated = {path} if notes_file(log).exists() else set()
    return _Files({path: (status.st_size, status.st_mtime_ns)}, nearby.reports, annotated)


def _find_files(folder: Path, problems: list[str], max_depth: int | None = None) -> _Files:
    """Logs, reports and notes below a folder; hidden folders and links to folders are left out."""
    files = _Files({}, {}, set())
    depth = len(folder.parts)

    def on_error(error: OSError) -> None:
        problems.append(f"cannot read the folder {error.filename}: {error.strerror}")

    for place, folders, names in os.walk(folder, onerror=on_error):
        is_deepest = max_depth is not None and len(Path(place).parts) - depth >= max_depth
        folders[:] = [] if is_deepest else sorted(f for f in folders if not f.startswith("."))
        for name in sorted(names):
            if not name.startswith("."):
                _add_file(files, os.path.join(place, name), name)
    return files


def _add_file(files: _Files, path: str, name: str) -> None:
    if name.endswith(NOTES_SUFFIX):
        files.annotated.add(path.removesuffix(NOTES_SUFFIX))
    elif name.endswith(_LOG_SUFFIX) or name == _REPORT_NAME:
        with suppress(OSError):  # deleted in the meantime
            status = os.stat(path)
            group = files.logs if name.endswith(_LOG_SUFFIX) else files.reports
            group[path] = status.st_size, status.st_mtime_ns


def _read_new_files(
    folder: Path, files: _Files, index: Index, progress: Progress, forget: bool
) -> dict[str, dict[str, Any]]:
    """Facts of all files, by path: from the index, or read and saved there. `forget`: remove files that are
    not in `files` from the index."""
    absolute = {path: os.path.abspath(path) for path in (*files.logs, *files.reports)}
    known = index.read(os.path.abspath(folder))
    stamps = {**files.logs, **files.reports}
    facts = {p: known[a][1] for p, a in absolute.items() if a in known and known[a][0] == stamps[p]}
    unread = [p for p in stamps if p not in facts]
    _logger.info("%s: %d files to read, %d known", folder, len(unread), len(facts))
    deleted = set(known) - set(absolute.values()) if forget else set()
    batch: dict[str, tuple[Stamp, dict[str, Any]]] = {}
    for done, path in enumerate(unread):
        progress(done, len(unread))
        is_log = path in files.logs
        facts[path] = asdict(read_facts(Path(path))) if is_log else read_report(Path(path))
        batch[absolute[path]] = stamps[path], facts[path]
        if len(batch) == _BATCH:
            index.update(batch, ())
            batch = {}
    progress(len(unread), len(unread))
    if batch or deleted:
        index.update(batch, deleted)
    return facts


def _assemble_runs(
    files: _Files, facts: dict[str, dict[str, Any]], problems: list[str]
) -> Iterator[CataloguedRun]:
    """Each log with the newest report about it, and with its notes."""
    reports: dict[str, tuple[str, dict[str, Any]]] = {}
    for path in sorted(files.reports, key=lambda p: files.reports[p][1]):
        reports.update({digest: (path, run) for digest, run in facts[path].items() if digest})
    for path, (size, _) in files.logs.items():
        own = facts[path] | {"faults": tuple(facts[path]["faults"])}
        report, reported = reports.get(own["fingerprint"], (None, None))
        notes = _read_notes(path, problems) if path in files.annotated else Notes()
        yield CataloguedRun(
            Path(path),
            size,
            **own,
            report=None if report is None else Path(report),
            reported=None if reported is None else ReportedRun(**reported),
            tags=notes.tags,
            notes=notes.notes,
        )


def _read_notes(path: str, problems: list[str]) -> Notes:
    try:
        return read_notes(Path(path))
    except EldirError as error:
        problems.append(str(error).splitlines()[0])
        return Notes()


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
