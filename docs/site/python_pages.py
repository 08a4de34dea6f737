"""A page for each public module, made from its docstrings."""

from pathlib import Path

from generated import write_pages

import eldir

# Modules whose names a program may use, in the order of the work. Others may change without notice.
MODULES = [
    "eldir.lattice", "eldir.genotype", "eldir.morphology", "eldir.controller", "eldir.terrain", "eldir.scene",
    "eldir.physics", "eldir.rollout", "eldir.learning", "eldir.evolution.search", "eldir.evolution.loop",
    "eldir.design", "eldir.trajectory", "eldir.marks", "eldir.show", "eldir.errors",
    "eldir.training.configuration", "eldir.training.fitting", "eldir.training.randomisation",
    "eldir.built.robot", "eldir.built.gait", "eldir.built.heat", "eldir.built.motion", "eldir.built.walking",
    "eldir.built.samples", "eldir.built.screening", "eldir.built.scene",
    "eldir_cad.checks.buildability", "eldir_cad.checks.violations", "eldir_cad.shortlist.ranking",
    "eldir_cad.packet.folder",
    "eldir_hardware.camera.tags",
    "eldir_hardware.rig.configuration", "eldir_hardware.planning.plan", "eldir_hardware.schedule",
    "eldir_hardware.run.drive",
    "eldir_hardware.run.player",
    "eldir_hardware.guardian.bank", "eldir_hardware.guardian.client",
    "eldir_hardware.relay.board", "eldir_hardware.relay.registration",
    "eldir_hardware.emulator.board", "eldir_hardware.log.reader", "eldir_hardware.vision.pipeline",
    "eldir_hardware.markers.tracker", "eldir_hardware.markers.registration",
    "eldir_hardware.vision.live_tracking",
    "eldir_calibration.identification.identification", "eldir_calibration.dynamics.results",
    "eldir_calibration.report.comparison",
]  # fmt: skip


def write(docs: Path) -> None:
    """Write docs/generated/python/MODULE.md for every public module."""
    pages = {}
    for name in MODULES:
        short = [n for n in eldir.__all__ if getattr(getattr(eldir, n), "__module__", "") == name]
        also = "".join(f"`eldir.{n}` is `{name}.{n}`. " for n in short)
        pages[name] = f"# {name}\n\n{also}\n\n```{{eval-rst}}\n.. automodule:: {name}\n```\n"
    write_pages(docs / "generated" / "python", pages)
