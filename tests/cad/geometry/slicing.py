"""Plates through an independent slicer: PrusaSlicer's SLA mode, where it is installed."""

import re
import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import NamedTuple

from eldir_cad.kit.printer import Printer

SLICER = shutil.which("prusa-slicer")
MISSING = "prusa-slicer is not installed (Debian: apt install prusa-slicer)"


class Sliced(NamedTuple):
    """What the slicer found on a plate."""

    manifold: int
    """Objects that it calls so."""
    volume: float
    """Resin of all layers [mm3]."""


def slice_plate(plate: Path, printer: Printer, folder: Path) -> Sliced:
    """Slice a 3MF plate. Warnings are errors."""
    settings = folder / "slicer.ini"
    settings.write_text(settings_of(printer))
    info = _run("--info", plate)
    sliced = folder / f"{plate.stem}.sl1"
    said = _run("--export-sla", "--load", settings, "--dont-arrange", "--loglevel", "3", "-o", sliced, plate)
    assert sliced.stat().st_size > 0
    for text in (info, said):
        assert not re.search(r"warning|error|repaired|outside|unable", text, re.IGNORECASE), text
    with zipfile.ZipFile(sliced) as archive:
        used = re.search(r"usedMaterial = ([\d.]+)", archive.read("config.ini").decode())
    assert used is not None
    return Sliced(info.count("manifold = yes"), 1e3 * float(used[1]))


def settings_of(printer: Printer) -> str:
    """The printer's plate and layers, without supports or pad."""
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


def _run(*arguments: object) -> str:
    assert SLICER is not None
    done = subprocess.run(
        [SLICER, *map(str, arguments)], capture_output=True, text=True, timeout=300, check=True
    )
    return done.stdout + done.stderr
