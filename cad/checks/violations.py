"""The results of the build filter: violations and figures of a design."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

from eldir.errors import InputError

Severity = Literal["refused", "unfit", "note"]


@dataclass(frozen=True)
class Violation:
    """A violation: one fault, or one fact that the workshop must know, with a remedy."""

    kind: str
    severity: Severity
    """refused: no packet; unfit: the shortlist leaves it out; note: the workshop must know."""
    parts: tuple[str, ...]
    """Names of the parts."""
    amount: float
    """Amount, in `unit`."""
    unit: str
    message: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.message}; {self.remedy}"


@dataclass(frozen=True)
class BuildReport:
    """Results of the build filter for one design."""

    violations: tuple[Violation, ...]
    figures: dict[str, float]
    """Figures of the design; the names end with the units."""

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
                raise InputError(
                    f"this design cannot be built: {v.message}", code="design.not-buildable", remedy=v.remedy
                )

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        return {
            "buildable": self.buildable,
            "fit": self.fit,
            "figures": self.figures,
            "violations": [asdict(v) | {"parts": list(v.parts)} for v in self.violations],
        }
