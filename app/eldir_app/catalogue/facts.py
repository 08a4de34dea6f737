"""What is known about a log: what the log says, what a report says, and what people noted."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, Field

from eldir.core.arguments import require_value
from eldir.core.files import MAX_JSON_BYTES, read_json, write_text
from eldir.core.records import FileRecord, Record, record
from eldir.errors import EldirError, InputError

_REAL_CLOCK = 946_684_800
"""A log with an earlier start (before the year 2000) was recorded in virtual time [s since 1970]."""
_File = TypeVar("_File")
NOTES_SUFFIX = ".notes.json"
_TAG_PATTERN = re.compile(r"[\w.+-]{1,40}")
_MAX_NOTE_LENGTH = 2000  # [characters]


@dataclass(frozen=True)
class LogFacts:
    """What a log says about itself; empty or None where it says nothing."""

    fingerprint: str = ""
    """SHA-256 of the log's size and of its last 64 KiB; it identifies the log."""
    recorded: str = ""
    """When the run began (ISO 8601, UTC); for a run in virtual time, the date of the file."""
    seconds: float = 0.0
    """Time from the start to the last message [s]."""
    frames: int = 0
    """Number of camera frames in the log."""
    rig: str = ""
    """Name of the rig."""
    physics: str = ""
    """What moved a virtual robot; `real` on a real rig, `emulated board` in a rehearsal on one."""
    rehearsal: bool = False
    """Whether it is a dry run on an emulated board: no real contact was switched."""
    design: str = ""
    """SHA-256 of the design file, hexadecimal."""
    robot: str = ""
    """`intact`, or how the robot differs from its design."""
    period_s: float | None = None
    """Period of the schedule [s]."""
    cycles: int | None = None
    """Cycles of the schedule that count."""
    predicted: float | None = None
    """Walk that the schedule predicts [body lengths per five cycles]."""
    ended: str = ""
    """Last status of the player."""
    faults: tuple[str, ...] = ()
    """Errors and warnings in the log, as sentences."""
    recovered: str = ""
    """What `eldir recover` reported as missing."""
    damage: str = ""
    """Why the log, or a file in it, cannot be read."""


@dataclass(frozen=True)
class ReportedRun:
    """What a report says about one log."""

    predicted: float | None
    """Predicted walk [body lengths per five cycles]."""
    filmed: float | None
    """Filmed walk [body lengths per five cycles]."""
    low: float | None
    """Lower end of the filmed walk's 95 % interval over cycles [body lengths per five cycles]."""
    high: float | None
    """Upper end of that interval [body lengths per five cycles]."""
    verdict: Literal["agrees", "undecided", "disagrees", ""]
    """Whether film and prediction agree; empty for a control robot."""
    sentence: str
    """The verdict in words; empty for a control robot."""


def read_facts(log: Path) -> LogFacts:
    """What a log says about itself. A log that cannot be read has `damage` and nothing else; where only an
    attached file is damaged, the rest is there."""
    # A listing that finds everything in the index needs none of these.
    from eldir_hardware.log import messages as m
    from eldir_hardware.log.mcap_file import fingerprint, iter_messages, read_contents
    from eldir_hardware.log.reader import is_dry_run

    try:
        content = read_contents(log)
        statuses = [
            status
            for _, _, message in iter_messages(log, [m.STATUS] if m.STATUS in content.topics else [])
            for status in message.status
        ]
        digest = fingerprint(log)
        epoch = content.epoch_ns * 1e-9
        recorded = epoch if epoch > _REAL_CLOCK else log.stat().st_mtime
        date = datetime.fromtimestamp(recorded, UTC).isoformat(timespec="seconds")
    except InputError as error:
        return LogFacts(damage=str(error).splitlines()[0])
    except (OSError, ArithmeticError, LookupError, ValueError) as error:
        return LogFacts(damage=f"{log} cannot be read ({type(error).__name__}: {error})".splitlines()[0])
    facts = LogFacts(
        fingerprint=digest,
        recorded=date.replace("+00:00", "Z"),
        seconds=round(max(0.0, content.end_ns * 1e-9 - epoch), 3),
        frames=content.topics.get(m.IMAGE, 0),
        rehearsal=is_dry_run(content.metadata, content.epoch_ns, content.attachments.get("rig.yaml", b"")),
        design=content.metadata.get("design_sha256", ""),
        ended=next((s.message for s in reversed(statuses) if s.name == "player"), ""),
        faults=tuple(f"{s.name}: {s.message}" for s in statuses if s.level),
        recovered=content.metadata.get("recovered", ""),
    )
    return _with_attached_files(facts, log, content.attachments, statuses)


def _with_attached_files(
    facts: LogFacts, log: Path, attachments: Mapping[str, bytes], statuses: Sequence[Any]
) -> LogFacts:
    """The facts, with those of the attached design, schedule and rig file."""
    from eldir.design import Design
    from eldir_hardware.log.messages import MOVED_BY, VIRTUAL_RIG
    from eldir_hardware.log.reader import read_attachment
    from eldir_hardware.rig.configuration import Rig
    from eldir_hardware.schedule import ActuationSchedule

    damage: list[str] = []

    def attached(name: str, build: Callable[[Any], _File]) -> _File | None:
        try:
            return read_attachment(attachments, log.name, name, build)
        except InputError as error:
            damage.append(str(error).splitlines()[0])
            return None

    design = attached("design.json", Design.from_json)
    schedule = attached("schedule.json", ActuationSchedule.from_json)
    rig = attached("rig.yaml", Rig.from_json)
    if design is not None:
        facts = replace(facts, robot=", ".join(design.variant.changes) or "intact")
    if schedule is not None:
        walk = schedule.predicted.walk
        predicted = None if walk is None else walk.mean
        facts = replace(facts, period_s=schedule.period_s, cycles=schedule.cycles, predicted=predicted)
    if rig is not None:
        physics = (s.message.removeprefix(MOVED_BY) for s in statuses if s.name == VIRTUAL_RIG)
        real = "emulated board" if facts.rehearsal else "real"
        kind = real if rig.kind == "real" else next(physics, "virtual")
        facts = replace(facts, rig=rig.name, physics=kind)
    return replace(facts, damage="; ".join(damage))


def read_report(path: Path) -> dict[str, dict[str, Any]]:
    """What a `report.json` says about its logs, by their fingerprints; empty for any other file."""
    try:
        return _reported_runs(read_json(path, "eldir-report/1", ("eldir-report/1",)))
    except (EldirError, AttributeError, LookupError, TypeError, ValueError):
        return {}  # another program's report.json


def _reported_runs(values: dict[str, Any]) -> dict[str, dict[str, Any]]:
    reported = {}
    for index, run in enumerate(values["runs"]):
        low, high = run["tracked_interval"] or (None, None)
        main = index == 0  # the others are control robots
        walk = values["verdict"]["body_lengths_per_5_cycles"]
        reported[str(run.get("fingerprint", ""))] = asdict(
            ReportedRun(
                predicted=walk["predicted"] if main else run["predicted"],
                filmed=run["tracked"],
                low=low,
                high=high,
                verdict=(walk["agreement"] or "") if main else "",
                sentence=values["verdict"]["text"] if main else "",
            )
        )
    return reported


def _check_tag(tag: str) -> str:
    if not _TAG_PATTERN.fullmatch(tag):
        raise ValueError(f"expected 1 to 40 letters, digits or _ . + -, found {tag!r:.60}")
    return tag


Tag = Annotated[
    str, AfterValidator(_check_tag), Field(json_schema_extra={"pattern": f"^{_TAG_PATTERN.pattern}$"})
]


@record
class Note(Record):
    """A note that a person wrote about a run."""

    written: str
    """When the note was written (ISO 8601, UTC)."""
    text: str
    """Text of the note; 1 to 2000 characters when written by eldir."""


@record
class Notes(FileRecord):
    """Notes and tags of one log."""

    FORMAT = "eldir-notes/1"
    OPTIONAL = frozenset()

    tags: Annotated[tuple[Tag, ...], AfterValidator(lambda tags: tuple(sorted(set(tags))))] = ()
    """Tags of the log, sorted: 1 to 40 letters, digits or any of `_.+-` each."""
    notes: tuple[Note, ...] = ()
    """Notes on the log, the oldest first."""

    def changed(self, note: str | None, tags: Sequence[str], untags: Sequence[str]) -> Notes:
        """With one more note, and with tags added and removed. Raises `InputError` for invalid ones."""
        remaining = tuple((set(self.tags) | set(tags)) - set(untags))
        if note is None:
            return Notes(remaining, self.notes)
        is_valid = note.strip() and len(note) <= _MAX_NOTE_LENGTH
        require_value("note", is_valid, f"1 to {_MAX_NOTE_LENGTH} characters", len(note))
        now = datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
        return Notes(remaining, (*self.notes, Note(now, note.strip())))


def notes_file(log: Path) -> Path:
    """The file with the notes of a log: `run.mcap.notes.json` beside `run.mcap`."""
    return log.with_name(log.name + NOTES_SUFFIX)


def read_notes(log: Path) -> Notes:
    """Notes of a log; none where there is no file. Raises `InputError` for a damaged file."""
    path = notes_file(log)
    return Notes.load(path) if path.exists() else Notes()


def write_notes(log: Path, notes: Notes) -> Path:
    """Write the notes of a log beside it; return the file. Raises `EldirError` if it cannot be written."""
    path, text = notes_file(log), json.dumps(notes.to_json(), indent=1, ensure_ascii=False) + "\n"
    if len(text.encode(errors="backslashreplace")) > MAX_JSON_BYTES:
        raise InputError(f"{path} would be too large", remedy="remove old notes from it")
    write_text(path, text)
    return path
