"""Edit the text of a rig file and keep its comments."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path

from ruamel.yaml import YAML

from eldir.core.files import write_text


def with_entries(text: str, section: str, entries: Mapping[str, float | str]) -> str:
    """The text with these entries of a section set."""
    yaml = YAML()
    values = yaml.load(text)
    place = values.setdefault(section, {})
    for name, value in entries.items():
        place[name] = value
    changed = io.StringIO()
    yaml.dump(values, changed)
    return changed.getvalue()


def set_entry(path: Path, section: str, name: str, value: float | str) -> None:
    """Change one entry of a rig file."""
    write_text(path, with_entries(path.read_text(), section, {name: value}))
