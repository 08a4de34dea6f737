"""What a workshop can print and a rig can drive: the conditions of an evolution for building.

Printers and rigs live in packages above this one. They offer their conditions through the entry-point group
`eldir.workshop`, as sub-commands do.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Protocol

from eldir.errors import EldirError
from eldir.evolution.printed.genome import Timing
from eldir.evolution.printed.search import Refused
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters

GROUP = "eldir.workshop"


@dataclass(frozen=True)
class Workshop:
    """Conditions that printed robots must keep, and their nominal parameters."""

    printed: BuiltParameters
    springs: SpringParameters
    """The springs on the rig's supply."""
    motors: int
    """Most motors that the rig can heat."""
    timings: tuple[Timing, ...]
    """Periods and times of heating that the rig allows."""
    refused: Refused
    """Says why a body cannot be built; empty if it can."""


class WorkshopOf(Protocol):
    """What the entry point gives: the workshop with this rig file, or with the rig of the template."""

    def __call__(self, rig: Path | None = None) -> Workshop: ...


def installed_workshop(rig: Path | None = None) -> Workshop:
    """The conditions of the installed packages. Raises `EldirError` where there are none."""
    for point in entry_points(group=GROUP):
        of: WorkshopOf = point.load()
        return of(rig)
    raise EldirError(
        "nothing here knows what can be built",
        expected=f"a package with an entry point of the group {GROUP}, such as eldir's own hardware",
        remedy="install eldir as a whole",
    )
