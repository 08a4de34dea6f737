"""Pages that are made from the program itself, in docs/generated/, which git ignores."""

import shutil
from collections.abc import Mapping
from pathlib import Path

_NOTE = "<!-- Written by `make docs`; do not edit. -->\n\n"


def write_pages(folder: Path, pages: Mapping[str, str]) -> None:
    """Write one Markdown page for each name; pages of an earlier build are removed."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name, text in pages.items():
        (folder / f"{name}.md").write_text(_NOTE + text.rstrip() + "\n", encoding="utf-8")


def plain(text: str) -> str:
    """Text for a cell of a table: one line, in which `<` and `|` mean themselves, and code stays code."""
    parts = " ".join(text.split()).replace("|", "\\|").split("`")
    parts[::2] = [p.replace("<", "\\<").replace("*", "\\*") for p in parts[::2]]
    return "`".join(parts)
