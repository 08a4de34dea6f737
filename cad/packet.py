"""The packet: all that a workshop needs to print, assemble and wire a robot, in one folder.

Written whole or not at all. The same design, specification and printer give the same bytes.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cad import drawing
from cad.assembly import Assembly, assemble
from cad.buildability import check
from cad.findings import findings_page
from cad.parts import FACES, Face
from cad.plates import Plate, nest
from cad.shapes import stl
from cad.specification import Printer, Specification, fit, load_printer, load_specification
from cad.traveller import pdf, traveller
from cad.variant import Variant, apply
from cad.violations import BuildReport
from eldir import __version__
from eldir.design import Design
from eldir.files import new_folder, write_bytes, write_text

FORMAT = "eldir-packet/1"


@dataclass(frozen=True)
class Packet:
    """What was written."""

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

    Raises `InputError` for a design that cannot be built, `EldirError` where `out` cannot be written.
    """
    printer = printer or load_printer()
    spec = fit(specification or load_specification(), printer)
    variant = variant or Variant()
    built = apply(design, variant)
    report = check(built.morphology, spec, printer)
    report.require_buildable()
    with new_folder(out) as folder:
        assembly = assemble(built.morphology, spec, built.marks)
        plates = nest(assembly.parts, assembly.counts, printer)
        _write_files(folder, built, assembly, plates, report, spec, printer, variant)
        manifest = _manifest(folder, assembly, plates, report, printer, variant)
        write_text(folder / "manifest.json", json.dumps(manifest, indent=1) + "\n")
    return Packet(out, report, manifest)


def relay_channels(motors: int) -> dict[tuple[int, Face], int]:
    """The relay channel, from 1, of each motor on each face: the front's first."""
    return {(m, face): 1 + m + motors * f for f, face in enumerate(FACES) for m in range(motors)}


def _write_files(
    folder: Path,
    built: Design,
    assembly: Assembly,
    plates: list[Plate],
    report: BuildReport,
    spec: Specification,
    printer: Printer,
    variant: Variant,
) -> None:
    built.save(folder / "design.json")
    for part in assembly.parts.values():
        write_bytes(folder / "parts" / f"{part.name}.stl", stl(part.mesh))
    for plate in plates:
        write_bytes(folder / "plates" / f"{plate.name}.3mf", plate.threemf())
        write_bytes(folder / "plates" / f"{plate.name}.stl", plate.stl())
    write_text(folder / "plates" / "slicer.ini", slicer_settings(printer))
    channels = relay_channels(assembly.morphology.motors)
    write_text(folder / "bom.csv", bill_of_materials(assembly, spec, printer, variant))
    write_text(folder / "wiring.csv", wiring(assembly, spec, channels))
    plan = drawing.assembly_map(assembly, spec, channels)
    write_bytes(folder / "assembly.pdf", pdf([plan, findings_page(assembly.morphology, report)]))
    write_bytes(folder / "preview.png", drawing.png(drawing.preview(assembly, spec)))
    sheets = traveller(assembly, plates, report, spec, printer, variant)
    write_bytes(folder / "traveller.pdf", pdf(sheets))


def bill_of_materials(assembly: Assembly, spec: Specification, printer: Printer, variant: Variant) -> str:
    """All that must be at hand, as CSV: printed parts, then what is bought."""
    density = printer.material.density * 1e-3  # g/mm3
    rows: list[list[object]] = []
    for name, count in assembly.counts.items():
        part = assembly.parts[name]
        size = [f"{part.volume:.1f}", f"{part.volume * density:.3f}"]
        rows.append([name, part.purpose, count, *size, f"{name}.stl", part.supports])
    coil = spec.coil
    bought: list[tuple[str, str, int]] = [
        (
            "shape_memory_spring",
            f"two-way Nitinol coil, {coil.cold_length:g} mm cold, {coil.hot_length:g} mm hot, "
            f"{coil.outer_diameter:g} mm outside",
            2 * assembly.morphology.motors,
        ),
        (
            "tracking_disc",
            f"coloured disc, {spec.mass.disc_diameter:g} mm, for m1 to m5",
            len(assembly.marks),
        ),
    ]
    if variant.ballast is not None:
        weight = f"weight of {variant.ballast.grams / 2:g} g for mass {variant.ballast.mass}"
        bought.append(("ballast", weight, 2))
    rows += [[name, purpose, count, "", "", "", ""] for name, purpose, count in bought]
    header = ["part", "purpose", "count", "volume_mm3", "weight_g", "file", "supports"]
    return _csv(header, rows)


def wiring(assembly: Assembly, spec: Specification, channels: dict[tuple[int, Face], int]) -> str:
    """Which relay channel heats which spring, as CSV; the resistance is to be measured."""
    body = assembly.morphology
    motors = np.flatnonzero(body.active)
    rows = [
        [motor, motors[motor], face, *body.springs[motors[motor]], channel, "", spec.coil.current_limit_a]
        for (motor, face), channel in channels.items()
    ]
    header = ["spring", "spring_in_design", "face", "mass_a", "mass_b", "relay_channel"]
    return _csv([*header, "resistance_ohm_measured", "current_limit_a"], rows)


def slicer_settings(printer: Printer) -> str:
    """The printer's plate for PrusaSlicer, with which a plate can be checked (`--load slicer.ini`)."""
    width, depth, height = printer.volume
    values = {
        "printer_technology": "SLA",
        "bed_shape": f"0x0,{width:g}x0,{width:g}x{depth:g},0x{depth:g}",
        "max_print_height": f"{height:g}",
        "display_width": f"{width:g}",
        "display_height": f"{depth:g}",
        "display_pixels_x": round(width / printer.pixel),
        "display_pixels_y": round(depth / printer.pixel),
        "display_orientation": "landscape",
        "layer_height": f"{printer.layer:g}",
        "initial_layer_height": f"{printer.layer:g}",
        "supports_enable": 0,
        "pad_enable": 0,
    }
    return "".join(f"{key} = {value}\n" for key, value in values.items())


def _manifest(
    folder: Path,
    assembly: Assembly,
    plates: list[Plate],
    report: BuildReport,
    printer: Printer,
    variant: Variant,
) -> dict[str, Any]:
    density = printer.material.density * 1e-3
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {
        "format": FORMAT,
        "version": __version__,
        "printer": printer.name,
        "material": printer.material.name,
        "variant": variant.to_json(),
        "marks": {f"m{i + 1}": int(mass) for i, mass in enumerate(assembly.marks)},
        "parts": {
            name: {
                "count": count,
                "volume_mm3": round(assembly.parts[name].volume, 3),
                "weight_g": round(assembly.parts[name].volume * density, 4),
            }
            for name, count in assembly.counts.items()
        },
        "totals": {
            "parts": sum(assembly.counts.values()),
            "plates": len(plates),
            "volume_mm3": round(assembly.volume, 3),
            "weight_g": round(assembly.volume * density, 3),
        },
        "build_report": report.to_json(),
        "files": {
            p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files
        },
    }


def _csv(header: list[str], rows: list[list[object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()
