"""Notes and tags of a log, in a file beside it that moves with it."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from eldir.core.files import load_json, write_text
from eldir.core.json_text import LARGEST
from eldir.errors import InputError

FORMAT = "eldir-notes/1"
ENDING = ".notes.json"
_TAG = re.compile(r"[\w.+-]{1,40}")
_LONGEST = 2000  # characters of a note


@dataclass(frozen=True)
class Note:
    """What somebody wrote about a run."""

    written: str
    """Date and time, ISO 8601 in UTC."""
    text: str


@dataclass(frozen=True)
class Notes:
    """Notes and tags of one log."""

    tags: tuple[str, ...] = ()
    """Sorted; letters, digits and any of `_.+-`, at most 40."""
    notes: tuple[Note, ...] = ()

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Notes:
        """From the object in a notes file. Raises `InputError` for tags and texts that may not be."""
        notes = [Note(str(n["written"]), str(n["text"])) for n in values["notes"]]
        return cls(_checked_tags(values["tags"]), tuple(notes))

    def to_json(self) -> dict[str, Any]:
        """The object of a notes file."""
        notes = [{"written": n.written, "text": n.text} for n in self.notes]
        return {"format": FORMAT, "tags": list(self.tags), "notes": notes}

    def changed(self, note: str | None, tags: Sequence[str], untags: Sequence[str]) -> Notes:
        """With one more note, with and without tags. Raises `InputError` for those that may not be."""
        kept = (set(self.tags) | set(_checked_tags(tags))) - set(untags)
        if note is None:
            return Notes(tuple(sorted(kept)), self.notes)
        if not note.strip() or len(note) > _LONGEST:
            raise InputError("a note is wrong", expected=f"1 to {_LONGEST} characters", found=f"{len(note)}")
        now = datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
        return Notes(tuple(sorted(kept)), (*self.notes, Note(now, note.strip())))


def notes_file(log: Path) -> Path:
    """Where the notes of a log stand: `run.mcap.notes.json` beside `run.mcap`."""
    return log.with_name(log.name + ENDING)


def read_notes(log: Path) -> Notes:
    """Notes of a log; none where there is no file. Raises `InputError` for a damaged file."""
    path = notes_file(log)
    return load_json(path, FORMAT, Notes.from_json) if path.exists() else Notes()


def write_notes(log: Path, notes: Notes) -> Path:
    """Write the notes of a log beside it; return the file. Raises `EldirError` if it cannot be written."""
    path, text = notes_file(log), json.dumps(notes.to_json(), indent=1, ensure_ascii=False) + "\n"
    if len(text.encode(errors="backslashreplace")) > LARGEST:
        raise InputError(f"{path} would be too large", remedy="remove old notes from it")
    write_text(path, text)
    return path


def _checked_tags(tags: Sequence[str]) -> tuple[str, ...]:
    for tag in tags:
        if not isinstance(tag, str) or not _TAG.fullmatch(tag):
            raise InputError(
                "a tag is wrong", expected="1 to 40 letters, digits or _ . + -", found=repr(tag)[:60]
            )
    return tuple(sorted(set(tags)))
