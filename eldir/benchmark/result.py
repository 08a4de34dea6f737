"""Writing the result of a measurement: a JSON file and a plot."""

from __future__ import annotations

import json
import os
import platform
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldir.core.files import new_folder, write_bytes, write_text
from eldir.core.installation import processor
from eldir.core.pictures import png
from eldir.core.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def save(out: Path, name: str, values: dict[str, Any], figure: Figure) -> None:
    """Writes a new folder `out` with `name`.json and `name`.png."""
    with new_folder(out) as folder:
        head = {"format": f"eldir-benchmark-{name}/1", "version": __version__, "machine": machine()}
        write_text(folder / f"{name}.json", json.dumps(head | values, indent=1) + "\n")
        write_bytes(folder / f"{name}.png", png(figure))


def say(line: str) -> None:
    """Prints a line of progress to stderr."""
    print(line, file=sys.stderr)


def machine() -> dict[str, Any]:
    """The machine on which the figures were measured."""
    name = processor()["processor"] or platform.machine()
    return {"processor": name, "cores": os.cpu_count() or 1, "system": platform.platform()}
