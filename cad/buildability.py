"""The build filter: what stands between a design and a robot that stands on the table."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from cad.law import StripLaw, built_parameters
from cad.parts import cap, connector, fitting, mass_volume, strip
from cad.rigidity import degrees_of_freedom, hinges
from cad.specification import Printer, Specification
from cad.stroke import foot_stroke, nearest_contacts, shortening, stroke
from eldir.built import build
from eldir.errors import InputError
from eldir.lattice import HALF_SIDE
from eldir.morphology import Morphology
from eldir.statics import freedoms, static_margin

Severity = Literal["refused", "unfit", "note"]
_CONTACTS_TOLD = 3


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


def check(morphology: Morphology, spec: Specification, printer: Printer) -> BuildReport:
    """Judge a body. One that is refused is not looked at further: its motion may cost much time."""
    violations = [*_workspace(morphology, spec), *_motors(morphology, spec)]
    figures: dict[str, float] = {}
    if not violations:
        for found, numbers in (
            _hinges(morphology),
            _mechanisms(morphology),
            _stroke(morphology, spec, printer),
            _standing(morphology, spec, printer),
            _counts(morphology, spec, printer),
        ):
            violations += found
            figures |= numbers
    return BuildReport(tuple(violations), figures)


_Found = tuple[list[Violation], dict[str, float]]


def _workspace(morphology: Morphology, spec: Specification) -> list[Violation]:
    width, height = np.ptp(morphology.positions, axis=0) / HALF_SIDE
    rows, columns = round(height / np.sqrt(3)), round(width) - 1
    room = spec.workspace
    over = max(rows - room.rows, columns - room.columns)
    if over <= 0:
        return []
    message = (
        f"it fills {rows} x {columns} triangles (rows x columns), the workspace is "
        f"{room.rows} x {room.columns}"
    )
    remedy = f"evolve on that workspace: eldir evolve --lattice {room.rows}x{room.columns}"
    return [Violation("workspace", "refused", ("body",), over, "triangles", message, remedy)]


def _motors(morphology: Morphology, spec: Specification) -> list[Violation]:
    most, found = spec.workspace.motors, morphology.motors
    names = tuple(f"spring {i}" for i in np.flatnonzero(morphology.active))
    if found == 0:
        message, by = "it has no active spring, so nothing would move", 1
    elif found > most:
        message, by = f"it has {found} active springs, at most {most} are built", found - most
    else:
        return []
    remedy = f"evolve with motors: eldir evolve --max-motors {most}"
    return [Violation("motors", "refused", names, by, "springs", message, remedy)]


def _hinges(morphology: Morphology) -> _Found:
    found = hinges(morphology)
    violations = []
    for hinge in found:
        alone = "nothing else holds them together" if hinge.separates else "they are also joined elsewhere"
        violations.append(
            Violation(
                "hinge",
                "note",
                (f"mass {hinge.mass}",),
                hinge.fans,
                "parts",
                f"mass {hinge.mass} is a hinge between {hinge.fans} parts of the body; {alone}",
                "seat its strips without play: their clamped ends are what holds the angle",
            )
        )
    return violations, {"hinges": len(found)}


def _mechanisms(morphology: Morphology) -> _Found:
    at, springs = morphology.positions, morphology.springs
    free = degrees_of_freedom(at, springs)
    figures: dict[str, float] = {
        "freedoms": free,
        "freedoms_generic": freedoms(at, springs),
        # These are what the motors drive: a body without any is rigid and hardly moves.
        "freedoms_without_motors": degrees_of_freedom(at, springs[~morphology.active]),
    }
    violations = []
    if free:
        violations.append(
            Violation(
                "mechanism",
                "note",
                ("body",),
                free,
                "degrees of freedom",
                f"with all its springs it can still fold in {free} way(s) if its strips were pinned",
                "clamp the strips: seat them without play",
            )
        )
    if figures["freedoms_without_motors"] == 0:
        violations.append(
            Violation(
                "rigid",
                "unfit",
                tuple(f"spring {i}" for i in np.flatnonzero(morphology.active)),
                0,
                "degrees of freedom",
                "its passive springs alone make it rigid: the motors can only strain it by millimetres",
                "choose a design with a mechanism that its motors close",
            )
        )
    return violations, figures


def _stroke(morphology: Morphology, spec: Specification, printer: Printer) -> _Found:
    law = StripLaw.of(spec, printer)
    motion = stroke(morphology, spec, law)
    violations = []
    for contact in nearest_contacts(motion, morphology, spec)[:_CONTACTS_TOLD]:
        one, other = contact.parts
        lack = spec.clearance - contact.gap
        violations.append(
            Violation(
                "collision",
                "unfit",
                contact.parts,
                lack,
                "mm",
                f"{one} and {other} lack {lack:.1f} mm of clearance within the motors' stroke",
                "shorten the heating, or choose another design",
            )
        )
    passive = np.flatnonzero(~morphology.active)
    short = shortening(motion, morphology)
    worst = int(passive[np.argmax(short[passive])]) if len(passive) else 0
    shortest = float(short[worst]) if len(passive) else 0.0
    strain = law.surface_strain(shortest)
    allowed = printer.material.strain_limit / spec.safety.strain
    if strain > allowed:
        violations.append(
            Violation(
                "strain",
                "note",
                (f"spring {worst}",),
                strain / allowed,
                "times the allowed strain",
                f"spring {worst} is bent to {strain:.1%} at its surface, {allowed:.1%} is allowed",
                "watch it for cracks, or print thinner strips",
            )
        )
    figures = {"foot_stroke_mm": foot_stroke(motion), "greatest_strain": strain}
    return violations, {k: round(v, 6) for k, v in figures.items()}


def _standing(morphology: Morphology, spec: Specification, printer: Printer) -> _Found:
    margin = 1e3 * static_margin(build(morphology, built_parameters(spec, printer)))
    figures = {"static_margin_mm": round(margin, 6)}
    lack = spec.safety.static_margin - margin
    if lack <= 0:
        return [], figures
    message = (
        f"its centre of mass lies {margin:.0f} mm inside its feet, "
        f"{spec.safety.static_margin:.0f} mm are asked: it may fall over"
    )
    remedy = "choose a design with feet further apart"
    return [Violation("static margin", "unfit", ("feet",), lack, "mm", message, remedy)], figures


def _counts(morphology: Morphology, spec: Specification, printer: Printer) -> _Found:
    """Printed parts of both planes, and their resin without supports."""
    degree = Counter(morphology.springs.ravel().tolist()).values()
    masses, full = len(degree), sum(n == 6 for n in degree)
    motors = morphology.motors
    each = _volumes(spec)
    counts = {
        "passive_spring": 2 * (len(morphology.springs) - motors),
        "spring_end": 4 * motors,
        "connector": masses - full,
        "cap": 2 * full,
    }
    volume = sum(each[name] * n for name, n in counts.items())
    volume += 2 * sum(mass_volume(spec, sockets) for sockets in degree)
    figures = {
        "masses": float(masses),
        "motors": float(motors),
        "parts": float(2 * masses + sum(counts.values())),
        "resin_mm3": round(volume, 1),
        "resin_g": round(volume * 1e-3 * printer.material.density, 2),
    }
    return [], figures


@lru_cache(maxsize=8)
def _volumes(spec: Specification) -> dict[str, float]:
    parts = (strip(spec), fitting(spec), connector(spec), cap(spec))
    return {p.name: p.volume for p in parts}
