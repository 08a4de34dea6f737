"""The packet: all files that a workshop needs to print, assemble and wire a robot, in one folder.

Written whole or not at all. The same design, specification and printer give the same bytes.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from eldir.controller import Controller
from eldir.core.arguments import require_value
from eldir.core.files import new_folder, write_bytes, write_text
from eldir.core.pictures import png
from eldir.core.version import __version__
from eldir.design import Design, Variant
from eldir.genotype import Genotype
from eldir.parameters.wiring import Wiring, wiring
from eldir_cad.checks.buildability import check
from eldir_cad.checks.contacts import leads
from eldir_cad.checks.strip_law import StripLaw
from eldir_cad.checks.stroke import stroke
from eldir_cad.checks.violations import BuildReport
from eldir_cad.geometry.shapes import stl
from eldir_cad.kit.fit import fitted_to_printer
from eldir_cad.kit.printer import Printer, load_printer
from eldir_cad.kit.specification import Specification, load_specification
from eldir_cad.packet import drawing, lists
from eldir_cad.packet.content import Content, make
from eldir_cad.packet.findings import findings_page
from eldir_cad.packet.manifest import Manifest
from eldir_cad.packet.traveller import order_of_work, pdf, stamped, traveller


@dataclass(frozen=True)
class Packet:
    """The packet that was written."""

    path: Path
    report: BuildReport
    manifest: Manifest


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
    built = apply_variant(design, variant)
    report = check(built.morphology, spec, printer)
    report.require_buildable()
    with new_folder(out) as folder:
        content = make(built, report, spec, printer, variant)
        connections = wiring(built.morphology.motors)
        _write_files(folder, content, connections)
        manifest = Manifest.of(folder, content, connections)
        manifest.save(folder / "manifest.json")
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
    write_bytes(folder / "preview.glb", drawing.preview_glb(c.assembly, c.spec))
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


def apply_variant(design: Design, variant: Variant) -> Design:
    """The design as it is built, with its `variant` (a motor replaced by a passive spring, a weight added)
    and with the marks of the evolved design. Raises `InputError` for a motor that does not exist."""
    if variant == Variant():
        return design
    genotype, controller = design.genotype, design.controller
    motor = variant.without_motor
    if motor is not None:
        body = design.morphology
        require_value("without_motor", 0 <= motor < body.motors, f"0 to {body.motors - 1}", motor)
        springs = genotype.springs.copy()
        springs[body.lattice_springs[body.active][motor]] = False
        genotype = Genotype(genotype.triangles, springs)
        left = np.arange(body.motors) != motor
        controller = Controller(controller.w1, controller.b1, controller.w2[left], controller.b2[left])
    # The marks stay where they are: the control robot is compared with the design, mass by mass.
    marks = tuple(design.marks.tolist())
    return replace(design, genotype=genotype, controller=controller, variant=variant, kept_marks=marks)
