"""Finds the logs below folders, with what reports and notes say about them."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from eldir.errors import EldirError, InputError, missing
from eldir_app.catalogue.facts import LogFacts, ReportedRun, read_facts, read_report
from eldir_app.catalogue.index import Index, Stamp
from eldir_app.catalogue.notes import ENDING, Note, Notes, notes_file, read_notes
from eldir_hardware.images.file_kind import require_log

_logger = logging.getLogger(__name__)

FORMAT = "eldir-runs/1"
_LOG, _REPORT = ".mcap", "report.json"
_TOGETHER = 20  # files that are read before the index is written
_NEAR = 2  # levels below a single log's folder where its report is looked for

Progress = Callable[[int, int], None]
"""Called with the number of files read so far, and of all that must be read."""


# No records of pydantic's: there are ten thousand.
@dataclass(frozen=True)
class _LogFile:
    """One log."""

    log: Path
    """Path of the log."""
    bytes: int
    """Size of the log [bytes]."""


@dataclass(frozen=True)
class CataloguedRun(LogFacts, _LogFile):  # in the file, the entries of the last base are the first
    """One log, and what is known about it."""

    report: Path | None = None
    """Path of the newest report.json about the log; null: there is none."""
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
        """The report's verdict in a word; empty without a report."""
        return "" if self.reported is None else self.reported.verdict


@dataclass(frozen=True)
class Catalogue:
    """The runs that were found, in the order of their paths, and what could not be read on the way."""

    runs: tuple[CataloguedRun, ...]
    problems: tuple[str, ...]


@dataclass(frozen=True)
class _Files:
    """Files below a folder, by path."""

    logs: dict[str, Stamp]
    reports: dict[str, Stamp]
    noted: set[str]
    """Logs that have a file of notes."""


def find_runs(
    paths: Sequence[Path], index: Index, progress: Progress = lambda done, every: None
) -> Catalogue:
    """The runs below folders, and those of single logs. What was read before is taken from the index, as long
    as size and time of a file are the same.

    Raises `InputError` for a path that does not exist or is no folder and no log.
    """
    runs: dict[str, CataloguedRun] = {}
    problems: list[str] = []
    for path in paths:
        if not path.exists():
            raise missing(path, "name a folder of logs, or a log")
        if path.is_dir():
            files = _files(path, problems)
        elif path.suffix == _LOG:
            status, log = path.stat(), str(path)
            noted = {log} if notes_file(path).exists() else set()
            near = _files(path.parent, problems, _NEAR)
            files = _Files({log: (status.st_size, status.st_mtime_ns)}, near.reports, noted)
        else:
            require_log(path)
            raise InputError(f"{path} is neither a folder nor a log", expected="a folder, or a file *.mcap")
        folder = path if path.is_dir() else path.parent
        for run in _catalogued(folder, files, index, problems, progress, whole=path.is_dir()):
            runs.setdefault(os.path.abspath(run.log), run)
    return Catalogue(tuple(runs.values()), tuple(problems))


def _files(folder: Path, problems: list[str], levels: int | None = None) -> _Files:
    """Files of interest; hidden folders and links to folders are left out."""
    found = _Files({}, {}, set())
    depth = len(folder.parts)

    def refused(error: OSError) -> None:
        problems.append(f"cannot look into {error.filename}: {error.strerror}")

    for place, folders, names in os.walk(folder, onerror=refused):
        deep = levels is not None and len(Path(place).parts) - depth >= levels
        folders[:] = [] if deep else sorted(f for f in folders if not f.startswith("."))
        for name in sorted(names):
            if name.startswith(".") or not name.endswith((_LOG, _REPORT, ENDING)):
                continue
            path = os.path.join(place, name)
            if name.endswith(ENDING):
                found.noted.add(path.removesuffix(ENDING))
                continue
            try:
                status = os.stat(path)
            except OSError:
                continue  # gone in the meantime
            if name.endswith(_LOG):
                found.logs[path] = status.st_size, status.st_mtime_ns
            elif name == _REPORT:
                found.reports[path] = status.st_size, status.st_mtime_ns
    return found


def _catalogued(
    folder: Path, files: _Files, index: Index, problems: list[str], progress: Progress, whole: bool
) -> Iterator[CataloguedRun]:
    absolute = {path: os.path.abspath(path) for path in (*files.logs, *files.reports)}
    known = index.below(os.path.abspath(folder))
    stamps = {**files.logs, **files.reports}
    facts = {p: known[a][1] for p, a in absolute.items() if a in known and known[a][0] == stamps[p]}
    unread = [p for p in stamps if p not in facts]
    _logger.info("%s: %d files to read, %d known", folder, len(unread), len(facts))
    gone = set(known) - set(absolute.values()) if whole else set()
    read: dict[str, tuple[Stamp, dict[str, Any]]] = {}
    for done, path in enumerate(unread):
        progress(done, len(unread))
        log = path in files.logs
        facts[path] = asdict(read_facts(Path(path))) if log else read_report(Path(path))
        read[absolute[path]] = stamps[path], facts[path]
        if len(read) == _TOGETHER:
            index.keep(read, ())
            read = {}
    progress(len(unread), len(unread))
    if read or gone:
        index.keep(read, gone)

    # The newest report about a log counts.
    reports: dict[str, tuple[str, dict[str, Any]]] = {}
    for path in sorted(files.reports, key=lambda p: files.reports[p][1]):
        reports.update({print_: (path, said) for print_, said in facts[path].items() if print_})
    for path, (size, _) in files.logs.items():
        own = facts[path] | {"faults": tuple(facts[path]["faults"])}
        where, said = reports.get(own["fingerprint"], (None, None))
        noted = _notes(path, problems) if path in files.noted else Notes()
        yield CataloguedRun(
            Path(path),
            size,
            **own,
            report=None if where is None else Path(where),
            reported=None if said is None else ReportedRun(**said),
            tags=noted.tags,
            notes=noted.notes,
        )


def _notes(path: str, problems: list[str]) -> Notes:
    try:
        return read_notes(Path(path))
    except EldirError as error:
        problems.append(str(error).splitlines()[0])
        return Notes()
