"""The packet: all files that a workshop needs to print, assemble and wire a robot, in one folder.

Written whole or not at all. The same design, specification and printer give the same bytes.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cad.checks.buildability import check
from cad.checks.contacts import leads
from cad.checks.strip_law import StripLaw
from cad.checks.stroke import stroke
from cad.checks.violations import BuildReport
from cad.geometry.inspection import Feature, Inspection
from cad.geometry.shapes import stl
from cad.kit.fit import fitted_to_printer
from cad.kit.printer import Printer, load_printer
from cad.kit.specification import Specification, load_specification
from cad.packet import drawing, lists
from cad.packet.content import Content, make
from cad.packet.findings import findings_page
from cad.packet.preview import glb
from cad.packet.traveller import order_of_work, pdf, stamped, traveller
from cad.packet.variant import apply
from eldir.core.files import new_folder, write_bytes, write_text
from eldir.core.pictures import png
from eldir.core.version import __version__
from eldir.design import Design, Variant
from eldir.parameters.wiring import Wiring, wiring, wiring_digest

FORMAT = "eldir-packet/1"


@dataclass(frozen=True)
class Packet:
    """The packet that was written."""

    path: Path
    report: BuildReport
    manifest: dict[str, Any]


def write_packet(
    design: Design,
    out: Path,
    specification: Specification | None = None,
    printer: Printer | None = None,
    variant: Variant | None = None,
) -> Packet:
    """Check the design, make its parts and write the folder `out`, which must not exist yet.

    Raises `InputError` for a design that cannot be built, `EldirError` where a part cannot be printed,
    parts do not fit together, or `out` cannot be written.
    """
    printer = printer or load_printer()
    spec = fitted_to_printer(specification or load_specification(), printer)
    variant = variant or Variant()
    built = apply(design, variant)
    report = check(built.morphology, spec, printer)
    report.require_buildable()
    with new_folder(out) as folder:
        content = make(built, report, spec, printer, variant)
        connections = wiring(built.morphology.motors)
        _write_files(folder, content, connections)
        manifest = _manifest(folder, content, connections)
        write_text(folder / "manifest.json", json.dumps(manifest, indent=1) + "\n")
    return Packet(out, report, manifest)


def _write_files(folder: Path, c: Content, connections: Wiring) -> None:
    c.built.save(folder / "design.json")
    for part in c.assembly.parts.values():
        write_bytes(folder / "parts" / f"{part.name}.stl", stl(part.mesh))
    for plate in c.plates:
        write_bytes(folder / "plates" / f"{plate.name}.3mf", plate.threemf())
        write_bytes(folder / "plates" / f"{plate.name}.stl", plate.stl())
    body = c.assembly.morphology
    write_text(folder / "bom.csv", lists.bill_of_materials(c))
    wires = leads(stroke(body, c.spec, StripLaw.of(c.spec, c.printer)), body, c.spec)
    write_text(folder / "wiring.csv", lists.wiring(c, connections, wires))
    ballast = c.variant.ballast.mass if c.variant.ballast else None
    plan = drawing.assembly_map(c.assembly, connections, ballast)
    head = _heading(folder, c)
    pages = [plan, *order_of_work(c), findings_page(body, c.report)]
    write_bytes(folder / "assembly.pdf", pdf(stamped(pages, head)))
    write_bytes(folder / "preview.png", png(drawing.preview(c.assembly, c.spec)))
    write_bytes(folder / "preview.glb", glb(c.assembly, c.spec))
    write_bytes(folder / "traveller.pdf", pdf(stamped(traveller(c), head)))


def _heading(folder: Path, c: Content) -> str:
    """Which robot the pages are for. The date is left to be filled in, as bytes must repeat."""
    born = c.built.provenance
    name = (
        f"robot {born['id']} of generation {born['generation']}"
        if {"id", "generation"} <= set(born)
        else "robot"
    )
    digest = hashlib.sha256((folder / "design.json").read_bytes()).hexdigest()[:12]
    return f"{name}; design.json {digest}; {c.printer.name}; eldir {__version__}; printed on ______________"


def _manifest(folder: Path, c: Content, connections: Wiring) -> dict[str, Any]:
    density = c.printer.material.density * 1e-3
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {
        "format": FORMAT,
        "version": __version__,
        "printer": c.printer.name,
        "material": c.printer.material.name,
        "variant": c.variant.to_json(),
        "marks": {f"m{i + 1}": int(mass) for i, mass in enumerate(c.assembly.marks)},
        "wiring": {
            "sha256": wiring_digest(connections),
            "channels": [connection._asdict() for connection in connections],
        },
        "parts": {
            name: {
                "count": count,
                "volume_mm3": round(c.assembly.parts[name].volume, 3),
                "weight_g": round(c.assembly.parts[name].volume * density, 4),
            }
            | _measured(c.inspections[name])
            for name, count in c.assembly.counts.items()
        },
        "totals": {
            "parts": sum(c.assembly.counts.values()),
            "plates": len(c.plates),
            "volume_mm3": round(c.assembly.volume, 3),
            "weight_g": round(c.assembly.volume * density, 3),
        },
        "clearance": {
            "asked_mm": round(c.spec.clearance, 6),
            "tightest_mm": round(c.gap[0], 4),
            "between": list(c.gap[1:]),
        },
        "build_report": c.report.to_json(),
        "files": {
            p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files
        },
    }


def _measured(found: Inspection) -> dict[str, Any]:
    """The measurements of a mesh as plain values; sizes in mm2 and mm3."""

    def sizes(features: tuple[Feature, ...]) -> list[dict[str, float]]:
        return [{"z_mm": f.z, "size": f.size} for f in features]

    return {
        "wall_mm": round(found.wall, 3),
        "gap_mm": round(found.gap, 3) if found.gap < float("inf") else None,
        "supports": found.supports,
        "overhangs_mm2": sizes(found.overhangs),
        "islands_mm2": sizes(found.islands),
        "cups_mm3": sizes(found.cups),
        "sealed_mm3": sizes(found.sealed),
    }
