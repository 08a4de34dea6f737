"""The whole workflow on the virtual rig, from a random population to the report."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from eldir.core.files import new_folder, write_text
from eldir.core.worker_process import WorkerProcess
from eldir.evolution.designs import load_run
from eldir.evolution.printed import defaults
from eldir.evolution.printed.configuration import PrintedEvolutionConfig
from eldir.evolution.printed.loop import evolve_printed
from eldir.evolution.printed.run_folder import PrintedRun
from eldir.evolution.printed.search import KNOWN, PrintedSearch
from eldir.evolution.printed.workshop import Workshop
from eldir.marks import marked_masses
from eldir_cad.packet.folder import write_packet
from eldir_cad.shortlist.folder import write_shortlist
from eldir_cad.shortlist.ranking import RankedDesign, Shortlist, rank
from eldir_calibration.comparison.motions import report_content
from eldir_calibration.comparison.predictions import SAMPLES
from eldir_calibration.report.comparison import CYCLES, MotionReport
from eldir_calibration.report.page import ReportInput, write_report
from eldir_hardware.planning.plan import plan
from eldir_hardware.planning.workshop import workshop
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.template import virtual_rig
from eldir_hardware.run.drive import drive_rig
from eldir_hardware.virtual.bodies import best_physics
from eldir_hardware.virtual.rig import BodyFrame

_GOOD = 1.5  # worth of a known elite that ends the evolution
_NEARLY = 0.9  # of the farthest walk: worth less than a mark
Step = Callable[[str, float], None]
"""Called with the name of the present step and the fraction of it that is done."""


@dataclass(frozen=True)
class Demo:
    """Results of the demo."""

    choice: RankedDesign
    shortlist: Shortlist
    report: MotionReport
    content: ReportInput


def run_demo(
    out: Path,
    seed: int,
    step: Step = lambda what, part: None,
    *,
    population: int = defaults.OFFSPRING,
    generations: int = 6,
    at_most: int = 12,
    finalists: int = 3,
    samples: int = SAMPLES,
    cycles: int = CYCLES,
    see: Callable[[BodyFrame], None] = lambda frame: None,
) -> Demo:
    """Write `run/`, `shortlist/`, `design.json`, `packet/`, `rig.yaml`, `schedule.json`, `log.mcap`,
    `metadata.yaml` (which makes a bag of the log) and `report/` into a new folder, whole or not at all.

    Evolution ends after `generations` if a robot walks well by then, else after `at_most`. The robot is
    predicted by the engine and, where MuJoCo is installed, moved by MuJoCo; `cycles` of its walk count. The
    same seed gives the same design, packet and schedule, byte for byte. `see` is called with the true
    position of the virtual robot, for pictures and tests; nothing else may use it.
    """
    with new_folder(out) as draft:
        given = _evolve(draft / "run", seed, population, generations, at_most, step)
        shortlist = rank(
            load_run(draft / "run"),
            finalists,
            seed=seed,
            progress=lambda what, part: step(f"choosing: {what}", part),
            springs=given.springs,
        )
        choice = choose_design(shortlist)
        write_shortlist(shortlist, draft / "shortlist")
        choice.design.save(draft / "design.json")
        step("packet for the workshop", 0.0)
        write_packet(choice.design, draft / "packet")
        rig_path = draft / "rig.yaml"
        write_text(rig_path, virtual_rig(seed, "design.json", physics=best_physics()))
        rig = Rig.load(rig_path)
        step("gait to schedule", 0.0)
        schedule = plan(choice.design, rig, seed=seed, samples=samples, cycles=cycles)
        schedule.save(draft / "schedule.json")
        total = schedule.duration
        drive_rig(
            schedule, rig, rig_path, draft / "log.mcap", draft / "design.json",
            lambda t: step("driving and filming the virtual rig", min(max(t / total, 0.0), 1.0)), see,
        )  # fmt: skip
        rate = rig.camera.rate_hz if rig.camera else 1.0
        with WorkerProcess("eldir_calibration.comparison.predictions") as worker:
            content = report_content(
                draft / "log.mcap",
                choice.design,
                worker,
                lambda n: step("tracking", min(n / (rate * total), 1.0)),
                samples=samples,
            )
        step("report", 0.0)
        report = write_report(content, draft / "report")
    return Demo(choice, shortlist, report, content)


def choose_design(shortlist: Shortlist) -> RankedDesign:
    """The first design; or one that is predicted to walk nearly as far and has more marks (m1 to m5) for the
    report to compare."""
    shortlist.require_candidates("try another seed")
    first = shortlist.candidates[0]
    near = [
        c for c in shortlist.candidates if c is first or c.spread.worth >= _NEARLY * first.spread.worth > 0
    ]
    return max(near, key=lambda c: len(marked_masses(c.design.morphology)))  # the first of equals


def _evolve(folder: Path, seed: int, population: int, generations: int, at_most: int, step: Step) -> Workshop:
    """A run like that of `eldir evolve --objective printed`."""
    given = workshop()
    config = PrintedEvolutionConfig(
        offspring=population,
        generations=at_most,
        seed=seed,
        printed=given.printed,
        springs=given.springs,
        timings=given.timings,
    )

    def progress(search: PrintedSearch, share: float) -> None:
        step("evolving bodies and gaits", (search.generation + share) / (at_most + 1))

    run = PrintedRun.create(folder, config)
    evolve_printed(
        run, given.refused, lambda search: search.generation > generations and walks_well(search), progress
    )
    return given


def walks_well(search: PrintedSearch) -> bool:
    """Whether a robot is known to walk as far as the demo asks for."""
    return any(w.worth >= _GOOD and len(w.walks) >= KNOWN for w in search.archive.ranked())


def folder_size(folder: Path) -> int:
    """Size of all files in a folder [byte]."""
    return sum(os.path.getsize(Path(base) / f) for base, _, files in os.walk(folder) for f in files)
