"""The results of the build filter: violations and figures of a design."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from eldir.core.records import Record, record
from eldir.errors import InputError

Severity = Literal["refused", "unfit", "note"]


@record
class Violation(Record):
    """A violation of the build rules, or a note for the workshop, with a remedy."""

    kind: str
    """Kind of the violation, such as collision."""
    severity: Severity
    """refused: no packet is written; unfit: the design is not put on a shortlist; note: for the workshop."""
    parts: tuple[str, ...]
    """Names of the parts concerned."""
    amount: int | float
    """Amount by which the limit is exceeded or missed, in `unit`."""
    unit: str
    """Unit of the amount."""
    message: str
    """Description of the violation."""
    remedy: str
    """What to do."""

    def __str__(self) -> str:
        return f"{self.message}; {self.remedy}"


@record
class BuildReport(Record):
    """Results of the build filter for one design."""

    buildable: bool
    """Whether a packet may be written: nothing is refused."""
    fit: bool
    """Whether the design may be on a shortlist: there are only notes."""
    figures: dict[str, float]
    """Figures of the design; the names end with the units."""
    violations: tuple[Violation, ...]
    """Violations, and notes for the workshop."""

    @classmethod
    def of(cls, violations: Sequence[Violation], figures: dict[str, float]) -> BuildReport:
        """The report of these violations."""
        kinds = {v.severity for v in violations}
        return cls("refused" not in kinds, kinds <= {"note"}, figures, tuple(violations))

    def require_buildable(self) -> None:
        """Raise `InputError` with the first reason why the design cannot be built."""
        for v in self.violations:
            if v.severity == "refused":
                raise InputError(
                    f"this design cannot be built: {v.message}", code="design.not-buildable", remedy=v.remedy
                )
