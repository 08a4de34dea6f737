"""What the build filter says of a design: each thing that is wrong, and the figures it found."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

from eldir.errors import InputError

Severity = Literal["refused", "unfit", "note"]


@dataclass(frozen=True)
class Violation:
    """One thing that is wrong or must be known, with the nearest remedy."""

    kind: str
    severity: Severity
    """refused: no packet; unfit: the shortlist leaves it out; note: the workshop must know."""
    parts: tuple[str, ...]
    """Which."""
    amount: float
    """By how much, in `unit`."""
    unit: str
    message: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.message}; {self.remedy}"


@dataclass(frozen=True)
class BuildReport:
    """What the filter found in one design."""

    violations: tuple[Violation, ...]
    figures: dict[str, float]
    """Numbers that later choices use; their units are in their names."""

    @property
    def buildable(self) -> bool:
        """Whether a packet may be written."""
        return all(v.severity != "refused" for v in self.violations)

    @property
    def fit(self) -> bool:
        """Whether it belongs on a shortlist."""
        return all(v.severity == "note" for v in self.violations)

    def require_buildable(self) -> None:
        """Raise `InputError` with the first reason against building."""
        for v in self.violations:
            if v.severity == "refused":
                raise InputError(f"this design cannot be built: {v.message}", remedy=v.remedy)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "buildable": self.buildable,
            "fit": self.fit,
            "figures": self.figures,
            "violations": [asdict(v) | {"parts": list(v.parts)} for v in self.violations],
        }
