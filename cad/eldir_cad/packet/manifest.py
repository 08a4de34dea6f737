"""The contents of a packet: parts that are modelled, measured, placed and nested on plates; and the file
manifest.json."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt

from eldir.core.records import OMITTED, FileRecord, Record, record
from eldir.core.version import __version__
from eldir.design import Design, Variant
from eldir.errors import EldirError, InputError
from eldir.parameters.wiring import Connection, Wiring, wiring_digest
from eldir_cad.checks.violations import BuildReport
from eldir_cad.geometry.assembly import Assembly, assemble, smallest_gap
from eldir_cad.geometry.ground import Ground, make_ground
from eldir_cad.geometry.inspection import Inspection, inspect, require_printable
from eldir_cad.geometry.parts import holder
from eldir_cad.geometry.plates import Plate, nest
from eldir_cad.kit.printer import Printer
from eldir_cad.kit.specification import Specification

Digest = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
_MIN_CLEARANCE = 0.98  # of the specified clearance, between placed parts: circles are polygons


@dataclass(frozen=True, eq=False)
class Content:
    """A robot that can be printed and assembled."""

    built: Design
    assembly: Assembly
    inspections: Mapping[str, Inspection]
    gap: tuple[float, str, str]
    plates: list[Plate]
    report: BuildReport
    spec: Specification
    printer: Printer
    filling: float
    """Weight of the shot in each ballast holder [g]."""
    ground: Ground | None
    """The ground under the robot; None: a table."""
    ground_plates: list[Plate]

    @property
    def variant(self) -> Variant:
        """How the built robot differs from the evolved one."""
        return self.built.variant


def make_content(built: Design, report: BuildReport, spec: Specification, printer: Printer) -> Content:
    """Model and inspect all parts, and nest them on plates. Raises `EldirError` for a part that cannot be
    printed, or parts that do not fit together."""
    ballast, filling = None, 0.0
    if built.variant.ballast is not None:
        mass = built.variant.ballast.mass
        if mass in built.marks:
            raise InputError(
                f"the ballast would hide the disc on mass {mass}",
                code="ballast.hides-disc",
                expected="a mass that is not one of m1 to m5",
                found=f"m{built.marks.tolist().index(mass) + 1}",
            )
        part, filling = holder(spec, built.variant.ballast.grams / 2, printer.material.density)
        ballast = (mass, part)
    # The camera sees the front face.
    assembly = assemble(built.morphology, spec, built.marks, ballast, disc_faces=("front",))
    inspections = {name: inspect(part.mesh, printer) for name, part in assembly.parts.items()}
    for name, part in assembly.parts.items():
        require_printable(name, part.mesh, inspections[name], printer)
    gap = smallest_gap(assembly)
    if gap[0] < _MIN_CLEARANCE * spec.clearance:
        raise EldirError(
            f"{gap[1]} and {gap[2]} do not fit together",
            code="part.no-clearance",
            expected=f"{spec.clearance:g} mm between them",
            found=f"{gap[0]:.3f} mm",
            remedy="check the dimensions in the specification",
        )
    plates = nest(assembly.parts, assembly.counts, printer)
    ground = _make_ground(built, assembly, spec, printer)
    own = [] if ground is None else _nest_ground(ground, printer)
    return Content(built, assembly, inspections, gap, plates, report, spec, printer, filling, ground, own)


def _make_ground(built: Design, assembly: Assembly, spec: Specification, printer: Printer) -> Ground | None:
    if built.printed_terrain is None:
        return None
    across = [
        float((assembly.parts[p.part].mesh.bounds @ np.asarray(p.rotation).T)[i, 2] + p.translation[2])
        for p in assembly.placements
        for i in range(2)
    ]
    positions = 1e-3 * assembly.centres
    depth = max(across) - min(across)
    return make_ground(built.printed_terrain, positions, depth, spec.clearance, printer)


def _nest_ground(ground: Ground, printer: Printer) -> list[Plate]:
    """Plates of their own: a robot is printed without its ground too."""
    parts = {piece.part.name: piece.part for piece in ground.pieces}
    plates = nest(parts, dict.fromkeys(parts, 1), printer)
    return [replace(plate, name=f"ground_{plate.name}") for plate in plates]


@record
class ManifestWiring(Record):
    """Which relay channel heats which spring."""

    sha256: Digest
    """SHA-256 of the map from channels to springs; its first 8 digits stand on the assembly map."""
    channels: tuple[Connection, ...]
    """Each relay channel that heats a spring."""


@record
class _PartTotals(Record):
    """Number and weight of a part."""

    count: PositiveInt
    """Number of pieces in the packet."""
    volume_mm3: PositiveFloat
    """Volume of one piece [mm3]."""
    weight_g: PositiveFloat
    """Weight of one piece, at the resin's density [g]."""


@record
class PartNumbers(Inspection, _PartTotals):  # in the file, the fields of the last base come first
    """A part, with measurements of one piece."""


@record
class GroundNumbers(_PartTotals):
    """A piece of the printed ground."""

    start_mm: float
    """Where it begins, from the robot's rearmost mass at the start [mm]."""
    end_mm: float
    """Where it ends [mm]."""
    height_mm: PositiveFloat
    """Height of the piece [mm]."""
    block_mm: NonNegativeFloat
    """Height of the block that it stands on [mm]; 0: on the table."""


@record
class Totals(Record):
    """Sums over all pieces."""

    parts: NonNegativeInt
    """Number of pieces."""
    plates: PositiveInt
    """Number of plates."""
    volume_mm3: float
    """Volume of all pieces [mm3]."""
    weight_g: float
    """Weight of all pieces [g]."""


@record
class Clearance(Record):
    """Smallest distance between placed parts."""

    asked_mm: float
    """Clearance of the specification, the printer's allowance included [mm]."""
    tightest_mm: float
    """Smallest distance that was measured [mm]."""
    between: tuple[str, str]
    """Names of the two parts between which it was measured."""


@record
class Manifest(FileRecord):
    """Contents of a build packet."""

    FORMAT = "eldir-packet/1"
    OPTIONAL = frozenset({"ground"})

    version: str
    """Version of eldir that wrote the file."""
    printer: str
    """Name of the printer."""
    material: str
    """Name of the resin."""
    variant: Variant
    """How the built robot differs from its design; empty if it does not."""
    marks: dict[Annotated[str, Field(pattern="^m[1-5]$")], NonNegativeInt]
    """Number of the mass that carries each tracking disc."""
    wiring: ManifestWiring
    """Which relay channel heats which spring; older packets lack it."""
    parts: dict[str, PartNumbers]
    """Each different part, by its name, with measurements of one piece."""
    totals: Totals
    """Sums over all pieces."""
    clearance: Clearance
    """Smallest distance between placed parts."""
    build_report: BuildReport
    """Findings of the build filter."""
    ground: Annotated[dict[str, GroundNumbers] | None, OMITTED]
    """Each piece of the ground under the robot, from the rear; not among `parts` and `totals`, which are the
    robot's. Left out for a robot on a table."""
    files: dict[str, Digest]
    """SHA-256 of every other file of the packet, by its path."""

    @classmethod
    def of(cls, folder: Path, c: Content, connections: Wiring) -> Manifest:
        """The manifest of the files in a folder."""
        density = c.printer.material.density * 1e-3
        volumes = {name: c.assembly.parts[name].volume for name in c.assembly.counts}
        files = sorted(p for p in folder.rglob("*") if p.is_file())
        return cls(
            __version__,
            c.printer.name,
            c.printer.material.name,
            c.variant,
            {f"m{i + 1}": int(mass) for i, mass in enumerate(c.assembly.marks)},
            ManifestWiring(wiring_digest(connections), connections),
            {
                name: PartNumbers(
                    count=count,
                    volume_mm3=round(volumes[name], 3),
                    weight_g=round(volumes[name] * density, 4),
                    **vars(c.inspections[name]),
                )
                for name, count in c.assembly.counts.items()
            },
            Totals(
                sum(c.assembly.counts.values()),
                len(c.plates),
                round(c.assembly.volume, 3),
                round(c.assembly.volume * density, 3),
            ),
            Clearance(round(c.spec.clearance, 6), round(c.gap[0], 4), c.gap[1:]),
            c.report,
            None
            if c.ground is None
            else {
                piece.part.name: GroundNumbers(
                    count=1,
                    volume_mm3=round(piece.part.volume, 3),
                    weight_g=round(piece.part.volume * density, 4),
                    start_mm=round(piece.start, 3),
                    end_mm=round(piece.end, 3),
                    height_mm=round(piece.height, 3),
                    block_mm=piece.block,
                )
                for piece in c.ground.pieces
            },
            {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files},
        )
