"""The whole circle on the virtual rig, from a random population to the report."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cad.buildability import check
from cad.packet import write_packet
from cad.specification import load_printer, load_specification
from calibration.comparison import MotionReport
from calibration.report import ReportInput, write_report
from eldir.design import Design
from eldir.errors import EldirError
from eldir.evolution import Evolution
from eldir.files import new_folder, write_text
from eldir.lattice import Lattice
from eldir.learning import learn
from eldir.marks import MARKS, marked_masses
from eldir.run import Run, load_run
from eldir.screening import MARGIN, Ensemble, Screened, ensemble, screen
from hardware.analysis import analyse
from hardware.drive import drive_rig
from hardware.planning import plan
from hardware.rig import Rig
from hardware.rig_template import virtual_rig

_POPULATION = 400
_GENERATIONS = 2
_FINALISTS = 4

Step = Callable[[str, float], None]
"""Told what is under way, and which part of it is done."""


@dataclass(frozen=True)
class Choice:
    """The design that goes to the workshop, and why."""

    design: Design
    screened: Screened
    ensemble: Ensemble


@dataclass(frozen=True)
class Demo:
    """What the demo found."""

    choice: Choice
    standing: int
    screened: int
    report: MotionReport
    content: ReportInput


def run_demo(out: Path, seed: int, step: Step = lambda what, part: None) -> Demo:
    """Write `run/`, `design.json`, `packet/`, `rig.yaml`, `schedule.json`, `log.mcap` and `report/` into a
    new folder, whole or not at all; the same seed gives the same design, packet and schedule."""
    with new_folder(out) as draft:
        _evolve(draft / "run", seed, step)
        designs = load_run(draft / "run")
        choice, judged = choose(designs, seed, lambda part: step("screening in the built scene", part))
        choice.design.save(draft / "design.json")
        step("packet for the workshop", 0.0)
        write_packet(choice.design, draft / "packet", load_specification(None), load_printer("xip"))
        rig_path = draft / "rig.yaml"
        write_text(rig_path, virtual_rig(seed, "design.json"))
        rig = Rig.load(rig_path)
        step("gait to schedule", 0.0)
        schedule = plan(choice.design, rig, seed=seed)
        schedule.save(draft / "schedule.json")
        total = schedule.duration
        drive_rig(
            schedule, rig, rig_path, draft / "log.mcap", draft / "design.json",
            lambda t: step("driving and filming the virtual rig", min(max(t / total, 0.0), 1.0)),
        )  # fmt: skip
        rate = rig.camera.rate_hz if rig.camera else 1.0
        content = analyse(
            draft / "log.mcap", choice.design, lambda n: step("tracking", min(n / (rate * total), 1.0))
        )
        step("report", 0.0)
        report = write_report(content, draft / "report")
    standing = sum(not s.rejected for s in judged)
    return Demo(choice, standing, len(judged), report, content)


def choose(
    designs: list[Design], seed: int, progress: Callable[[float], None] = lambda part: None
) -> tuple[Choice, list[Screened]]:
    """The design whose builds walk farthest on average, of those that pass the build filter."""
    spec, printer = load_specification(None), load_printer("xip")
    fit = [d for d in designs if check(d.morphology, spec, printer).buildable]
    if not fit:
        raise EldirError(
            "no evolved design can be built", remedy="evolve a larger population, or try another seed"
        )
    judged = screen([d.morphology for d in fit], progress=lambda part: progress(0.9 * part))
    walkers = sorted((s for s in judged if s.exact and np.isfinite(s.best)), key=lambda s: -s.best)
    # Five marks where any walker has them: the report compares m1 to m5.
    marked = [s for s in walkers if len(marked_masses(fit[s.index].morphology)) == MARKS] or walkers
    if not marked:
        raise EldirError("no evolved design stays upright when built", remedy="try another seed")
    finalists = []
    for done, s in enumerate(marked[:_FINALISTS]):
        assert s.gait is not None
        finalists.append((ensemble(fit[s.index].morphology, s.gait, seed=seed), s))
        progress(0.9 + 0.1 * (done + 1) / _FINALISTS)
    builds, best = max(finalists, key=lambda pair: pair[0].expected)
    design = fit[best.index]
    return Choice(replace(design, provenance=design.provenance | _why(best, builds)), best, builds), judged


def _why(best: Screened, builds: Ensemble) -> dict[str, object]:
    return {
        "static_margin_m": round(best.margin, 6),
        "predicted_body_lengths_per_5_cycles": round(best.best, 6),
        "ensemble_mean": round(builds.mean, 6),
        "ensemble_fallen": round(builds.fallen, 6),
        "ensemble_probability_forward": builds.probability_forward,
    }


def _evolve(folder: Path, seed: int, step: Step) -> None:
    """A run as `eldir evolve` makes it, on the lattice for building."""
    config = Evolution(
        lattice=Lattice(6, 11),
        population=_POPULATION,
        generations=_GENERATIONS,
        max_active=2,
        static_margin=MARGIN,
        seed=seed,
    )
    run = Run.create(folder, config)
    search = run.restore()
    while not search.finished:
        robots = search.ask()
        done = search.generation

        def progress(learned: int, done: int = done) -> None:
            part = (done + learned / _POPULATION) / (_GENERATIONS + 1)
            step("evolving and teaching", part)

        outcome = learn(
            robots.morphologies(config.lattice), config.scene, config.iterations, robots.seeds.tolist(),
            progress=progress,
        )  # fmt: skip
        run.save(search, search.tell(robots, outcome))


def folder_size(folder: Path) -> int:
    """Bytes of all files."""
    return sum(os.path.getsize(Path(base) / f) for base, _, files in os.walk(folder) for f in files)
