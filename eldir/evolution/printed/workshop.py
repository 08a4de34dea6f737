"""What a workshop can print and a rig can drive: the conditions of an evolution for building.

Printers and rigs live in packages above this one: `eldir_hardware.planning.workshop` knows them.
"""

from __future__ import annotations

from dataclasses import dataclass

from eldir.evolution.printed.genome import Timing
from eldir.evolution.printed.search import Refused
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters


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
