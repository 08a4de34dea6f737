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
    "cad.checks.buildability", "cad.checks.violations", "cad.shortlist.ranking", "cad.packet.folder",
    "calibration.camera.tags",
    "hardware.rig.configuration", "hardware.planning.plan", "hardware.schedule", "hardware.run.drive",
    "hardware.run.player",
    "hardware.guardian.client", "hardware.relay.board", "hardware.relay.registration",
    "hardware.emulator.board", "hardware.log.reader", "hardware.vision.pipeline",
    "hardware.markers.tracker", "hardware.markers.registration",
    "hardware.vision.live_tracking",
]  # fmt: skip


def write(docs: Path) -> None:
    """Write docs/generated/python/MODULE.md for every public module."""
    pages = {}
    for name in MODULES:
        short = [n for n in eldir.__all__ if getattr(getattr(eldir, n), "__module__", "") == name]
        also = "".join(f"`eldir.{n}` is `{name}.{n}`. " for n in short)
        pages[name] = f"# {name}\n\n{also}\n\n```{{eval-rst}}\n.. automodule:: {name}\n```\n"
    write_pages(docs / "generated" / "python", pages)
