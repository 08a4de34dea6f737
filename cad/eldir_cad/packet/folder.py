"""The packet: all files that a workshop needs to print, assemble and wire a robot, in one folder.

Written completely or not at all. The same design, specification and printer give the same bytes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from eldir.built.gait import read_gait
from eldir.built.robot import build
from eldir.controller import Controller
from eldir.core.arguments import require_value
from eldir.core.files import new_folder, write_bytes, write_text
from eldir.core.pictures import pdf, png
from eldir.core.version import __version__
from eldir.design import Design, Variant
from eldir.errors import InputError
from eldir.genotype import Genotype
from eldir.parameters.wiring import Wiring, wiring
from eldir.terrain import TerrainFile
from eldir_cad.checks.buildability import check_with_leads
from eldir_cad.checks.contacts import Lead
from eldir_cad.checks.kit_differences import different_parameters
from eldir_cad.checks.strip_law import built_parameters
from eldir_cad.checks.violations import BuildReport
from eldir_cad.geometry.shapes import stl
from eldir_cad.kit.prices import Prices
from eldir_cad.kit.printer import Printer, fit_to_printer, load_printer
from eldir_cad.kit.specification import Specification, load_specification
from eldir_cad.packet import _drawing
from eldir_cad.packet._kit import draw_kit
from eldir_cad.packet._layout import add_footer
from eldir_cad.packet._pages import draw_findings, draw_ground, draw_order_of_work, draw_traveller
from eldir_cad.packet._tables import bill_of_materials, lead_lengths, wiring_table
from eldir_cad.packet._viewer import assembly_page
from eldir_cad.packet.cost import Cost, total_cost
from eldir_cad.packet.manifest import Content, Manifest, make_content
from eldir_cad.packet.shopping import bench_items, parts_to_buy

_OF_EVOLVED = "predicted", "evolved_walk", "built_walk"
"""Entries of a design's provenance that predict the walk of the evolved robot."""


@dataclass(frozen=True)
class Packet:
    """The packet that was written."""

    path: Path
    report: BuildReport
    manifest: Manifest
    cost: Cost | None
    """What robot and bench cost; None: no prices were given."""


def write_packet(
    design: Design,
    out: Path,
    specification: Specification | None = None,
    printer: Printer | None = None,
    variant: Variant | None = None,
    *,
    in_series: bool = False,
    prices: Prices | None = None,
    more_files: Mapping[str, bytes] | None = None,
) -> Packet:
    """Check the design, make its parts and write the folder `out`, which must not exist yet.

    `variant`: changes of the built robot, for a design without; by default as the design file says.
    `in_series`: both springs of a motor are wired in series on one relay channel. `prices`: for what
    bom.csv and kit.pdf list. `more_files`: further files, by name, such as those of
    `eldir_hardware.markers.placement`.

    Raises `InputError` for a design that cannot be built, `EldirError` where a part cannot be printed,
    parts do not fit together, or `out` cannot be written.
    """
    printer = printer or load_printer()
    spec = fit_to_printer(specification or load_specification(), printer)
    built = apply_variant(design, variant or Variant())
    built = replace(built, other_parts=different_parameters(spec, printer))
    report, leads = check_with_leads(built.morphology, spec, printer, ballast=built.ballast / 2)
    report.require_buildable()
    with new_folder(out) as folder:
        content = make_content(built, report, spec, printer)
        connections = wiring(built.morphology.motors, in_series=in_series)
        cost = _write_files(folder, content, connections, leads, prices)
        for name, data in (more_files or {}).items():
            write_bytes(folder / name, data)
        manifest = Manifest.of(folder, content, connections)
        manifest.save(folder / "manifest.json")
    return Packet(out, report, manifest, cost)


def _write_files(
    folder: Path, c: Content, connections: Wiring, leads: Sequence[Lead], prices: Prices | None
) -> Cost | None:
    c.built.save(folder / "design.json")
    for part in c.assembly.parts.values():
        write_bytes(folder / "parts" / f"{part.name}.stl", stl(part.mesh))
    for plate in c.plates:
        write_bytes(folder / "plates" / f"{plate.name}.3mf", plate.threemf())
        write_bytes(folder / "plates" / f"{plate.name}.stl", plate.stl())
    if c.ground is not None and c.built.printed_terrain is not None:
        TerrainFile("printed", c.built.printed_terrain).save(folder / "ground" / "terrain.json")
        for piece in c.ground.pieces:
            write_bytes(folder / "ground" / f"{piece.part.name}.stl", stl(piece.part.mesh))
        for plate in c.ground_plates:
            write_bytes(folder / "plates" / f"{plate.name}.3mf", plate.threemf())
            write_bytes(folder / "plates" / f"{plate.name}.stl", plate.stl())
    lead_mm = max(lead_lengths(leads).values())
    for_robot, for_bench = parts_to_buy(c), bench_items(c, connections, lead_mm)
    cost = None if prices is None else total_cost(c, for_robot, for_bench, prices)
    write_text(folder / "bom.csv", bill_of_materials(c, [*for_robot, *for_bench], prices))
    write_text(folder / "wiring.csv", wiring_table(c, connections, leads))
    ballast = c.variant.ballast.mass if c.variant.ballast else None
    plan = _drawing.draw_assembly_map(c.assembly, connections, ballast)
    footer = _footer(folder, c)
    preview = png(_drawing.draw_robot(c.assembly, c.spec))
    robot = build(c.built.morphology, built_parameters(c.spec, c.printer), ballast=c.built.ballast / 2)
    findings = draw_findings(c.built.morphology, robot, c.report)
    pages = [plan, *draw_order_of_work(c, connections, preview), findings]
    if c.ground is not None:
        pages.append(draw_ground(c, c.ground))
    write_bytes(folder / "assembly.pdf", pdf(add_footer(pages, footer)))
    write_bytes(folder / "kit.pdf", pdf(add_footer(draw_kit(c, connections, lead_mm, prices), footer)))
    write_text(folder / "assembly.html", assembly_page(c.assembly, c.spec, connections))
    write_bytes(folder / "preview.png", preview)
    write_bytes(folder / "preview.glb", _drawing.robot_glb(c.assembly, c.spec))
    write_bytes(folder / "traveller.pdf", pdf(add_footer(draw_traveller(c), footer)))
    return cost


def _footer(folder: Path, c: Content) -> str:
    """Which robot the pages are for. The date is filled in by hand, so that the bytes are reproducible."""
    origin = c.built.provenance
    name = (
        f"robot {origin['id']} of generation {origin['generation']}"
        if {"id", "generation"} <= set(origin)
        else "robot"
    )
    digest = hashlib.sha256((folder / "design.json").read_bytes()).hexdigest()[:12]
    return f"{name}; design.json {digest}; {c.printer.name}; eldir {__version__}; printed on ______________"


def apply_variant(design: Design, variant: Variant) -> Design:
    """The design as it is built, with its `variant` (a motor replaced by a passive spring, a weight added)
    and with the markers of the evolved design. Its other motors keep their part of the gait; walks that were
    predicted for the evolved robot are left out. Raises `InputError` for a motor that does not exist, and
    for a design with another variant."""
    if variant in (Variant(), design.variant):
        return design
    if design.variant != Variant():
        raise InputError(
            "the design has been changed for building already",
            code="design.has-variant",
            expected="the evolved design",
            found=f"a robot {design.variant}",
            remedy="give the evolved design, and all changes at once",
        )
    genotype, controller, gait = design.genotype, design.controller, read_gait(design)
    provenance = {name: value for name, value in design.provenance.items() if name not in _OF_EVOLVED}
    motor = variant.without_motor
    if motor is not None:
        body = design.morphology
        require_value("without_motor", 0 <= motor < body.motors, f"0 to {body.motors - 1}", motor)
        springs = genotype.springs.copy()
        springs[body.lattice_springs[body.active][motor]] = False
        genotype = Genotype(genotype.triangles, springs)
        kept = np.arange(body.motors) != motor
        controller = Controller(controller.w1, controller.b1, controller.w2[kept], controller.b2[kept])
        if gait is not None:
            provenance["gait"] = replace(gait, phase=gait.phase[kept], duty=gait.duty[kept]).to_json()
    # The markers stay on their masses: the control robot is compared with the design, mass by mass.
    marks = tuple(design.marks.tolist())
    return replace(
        design,
        genotype=genotype,
        controller=controller,
        variant=variant,
        kept_marks=marks,
        provenance=provenance,
    )
