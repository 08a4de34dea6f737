"""Notes and tags of a log, in a file beside it that moves with it."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field

from eldir.core.arguments import require_value
from eldir.core.files import write_text
from eldir.core.json_text import LARGEST
from eldir.core.records import FileRecord, Record, record
from eldir.errors import InputError

ENDING = ".notes.json"
_TAG = re.compile(r"[\w.+-]{1,40}")
_MAX_CHARACTERS = 2000  # of a note


def _checked(tag: str) -> str:
    if not _TAG.fullmatch(tag):
        raise ValueError(f"expected 1 to 40 letters, digits or _ . + -, found {tag!r:.60}")
    return tag


Tag = Annotated[str, AfterValidator(_checked), Field(json_schema_extra={"pattern": f"^{_TAG.pattern}$"})]


@record
class Note(Record):
    """What somebody wrote about a run."""

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
        """With one more note, with and without tags. Raises `InputError` for those that may not be."""
        kept = tuple((set(self.tags) | set(tags)) - set(untags))
        if note is None:
            return Notes(kept, self.notes)
        good = note.strip() and len(note) <= _MAX_CHARACTERS
        require_value("note", good, f"1 to {_MAX_CHARACTERS} characters", len(note))
        now = datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
        return Notes(kept, (*self.notes, Note(now, note.strip())))


def notes_file(log: Path) -> Path:
    """Where the notes of a log stand: `run.mcap.notes.json` beside `run.mcap`."""
    return log.with_name(log.name + ENDING)


def read_notes(log: Path) -> Notes:
    """Notes of a log; none where there is no file. Raises `InputError` for a damaged file."""
    path = notes_file(log)
    return Notes.load(path) if path.exists() else Notes()


def write_notes(log: Path, notes: Notes) -> Path:
    """Write the notes of a log beside it; return the file. Raises `EldirError` if it cannot be written."""
    path, text = notes_file(log), json.dumps(notes.to_json(), indent=1, ensure_ascii=False) + "\n"
    if len(text.encode(errors="backslashreplace")) > LARGEST:
        raise InputError(f"{path} would be too large", remedy="remove old notes from it")
    write_text(path, text)
    return path
