"""The results of the build filter: violations and figures of a design."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from eldir.core.records import Record, record
from eldir.errors import InputError

Severity = Literal["refused", "unfit", "note"]


@record
class Violation(Record):
    """A violation: one fault, or one fact that the workshop must know, with a remedy."""

    kind: str
    """What is wrong, such as collision."""
    severity: Severity
    """refused: no packet; unfit: the shortlist leaves the design out; note: the workshop must know."""
    parts: tuple[str, ...]
    """Names of the parts concerned."""
    amount: int | float
    """Amount by which the limit is missed, in `unit`."""
    unit: str
    """Unit of the amount."""
    message: str
    """The fault in words."""
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
    """Whether the design belongs on a shortlist: there are notes at most."""
    figures: dict[str, float]
    """Figures of the design; the names end with the units."""
    violations: tuple[Violation, ...]
    """Faults, and facts that the workshop must know."""

    @classmethod
    def of(cls, violations: Sequence[Violation], figures: dict[str, float]) -> BuildReport:
        """The report of these violations."""
        kinds = {v.severity for v in violations}
        return cls("refused" not in kinds, kinds <= {"note"}, figures, tuple(violations))

    def require_buildable(self) -> None:
        """Raise `InputError` with the first reason against building."""
        for v in self.violations:
            if v.severity == "refused":
                raise InputError(
                    f"this design cannot be built: {v.message}", code="design.not-buildable", remedy=v.remedy
                )
