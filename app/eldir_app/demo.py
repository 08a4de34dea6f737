"""The whole workflow on the virtual rig, from a random population to the report."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from eldir import defaults
from eldir.built.gait import CYCLES
from eldir.built.samples import SAMPLES
from eldir.core.files import new_folder, write_text
from eldir.core.worker_process import WorkerProcess
from eldir.design import Design, marked_masses
from eldir.evolution.archive import Archive
from eldir.evolution.designs import load_run
from eldir.evolution.loop import run_generations
from eldir.evolution.printed.configuration import PrintedEvolutionConfig
from eldir.evolution.printed.problem import MAX_SAMPLES
from eldir.evolution.printed.run_folder import PrintedRun
from eldir.evolution.printed.walker import Walker
from eldir_cad.kit.specification import load_specification
from eldir_cad.packet.folder import write_packet
from eldir_cad.shortlist.folder import write_shortlist
from eldir_cad.shortlist.ranking import RankedDesign, Shortlist, rank
from eldir_calibration.comparison.motions import prepare_report
from eldir_calibration.report.comparison import MotionReport
from eldir_calibration.report.page import ReportInput, write_report
from eldir_hardware.markers.placement import placement_files
from eldir_hardware.planning.plan import PlanConfig, plan
from eldir_hardware.planning.workshop import make_workshop
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.template import virtual_rig
from eldir_hardware.run.drive import DriveConfig, drive_rig
from eldir_hardware.virtual.bodies import default_physics
from eldir_hardware.virtual.rig import BodyFrame

_GOOD_FITNESS = 1.5  # of an elite with enough samples; it ends the evolution
_ABOUT_AS_FAR = 0.95  # of the best fitness: less than the error of 16 samples
Progress = Callable[[str, float], None]
"""Called with the name of the present stage and its completed fraction."""


@dataclass(frozen=True)
class DemoConfig:
    """Settings of the demo."""

    seed: int = 1
    population: int = defaults.PRINTED_OFFSPRING
    min_generations: int = 6
    """Evolution ends here if a robot walks well."""
    max_generations: int = 12
    finalists: int = 4
    """Designs of the shortlist."""
    samples: int = SAMPLES
    """Sampled robots of a prediction."""
    cycles: int = CYCLES
    """Cycles of the walk that are evaluated."""


@dataclass(frozen=True)
class DemoResult:
    """Results of the demo."""

    choice: RankedDesign
    shortlist: Shortlist
    report: MotionReport
    content: ReportInput


def run_demo(
    out: Path,
    config: DemoConfig,
    progress: Progress = lambda stage, fraction: None,
    on_frame: Callable[[BodyFrame], None] = lambda frame: None,
) -> DemoResult:
    """Write `run/`, `shortlist/`, `design.json`, `packet/`, `rig.yaml`, `schedule.json`, `log.mcap`,
    `metadata.yaml` (which makes the log a bag) and `report/` into a new folder, completely or not at all.

    The engine predicts the walk; MuJoCo, where it is installed, moves the robot. The same seed gives the same
    design, packet and schedule, byte for byte. `on_frame` is called with the true position of the virtual
    robot, for pictures and tests; nothing else may use it.
    """
    with new_folder(out) as draft:
        shortlist = _evolve_shortlist(draft, config, progress)
        choice = choose_design(shortlist, config.seed)
        write_shortlist(shortlist, draft / "shortlist")
        choice.design.save(draft / "design.json")
        progress("packet for the workshop", 0.0)
        sheets = placement_files(choice.design, 1e-3 * load_specification().scale)
        write_packet(choice.design, draft / "packet", more_files=sheets)
        content = _drive_and_track(choice.design, draft, config, progress, on_frame)
        progress("report", 0.0)
        report = write_report(content, draft / "report")
    return DemoResult(choice, shortlist, report, content)


def _evolve_shortlist(folder: Path, config: DemoConfig, progress: Progress) -> Shortlist:
    """Evolve robots as `eldir evolve --objective printed` does, and rank them."""
    conditions = make_workshop()
    evolution = PrintedEvolutionConfig(
        offspring=config.population,
        generations=config.max_generations,
        seed=config.seed,
        printed=conditions.printed,
        springs=conditions.springs,
        timings=conditions.timings,
    )

    run = PrintedRun.create(folder / "run", evolution)
    search = run.restore(conditions.rejection_reason)

    def is_done() -> bool:
        return search.generation > config.min_generations and has_good_walker(search.archive)

    def show(fraction: float) -> None:
        completed = (search.generation + fraction) / (config.max_generations + 1)
        progress("evolving bodies and gaits", completed)

    run_generations(run, search, run.workers(), is_done, show)
    return rank(
        load_run(run.path),
        config.finalists,
        seed=config.seed,
        progress=lambda stage, fraction: progress(f"choosing: {stage}", fraction),
        springs=conditions.springs,
    )


def _drive_and_track(
    design: Design,
    folder: Path,
    config: DemoConfig,
    progress: Progress,
    on_frame: Callable[[BodyFrame], None],
) -> ReportInput:
    """Plan a gait, play it on a virtual rig, and track the robot in the log."""
    rig_file = folder / "rig.yaml"
    write_text(rig_file, virtual_rig(config.seed, "design.json", physics=default_physics()))
    rig = Rig.load(rig_file)
    progress("gait to schedule", 0.0)
    schedule = plan(design, rig, PlanConfig(seed=config.seed, samples=config.samples, cycles=config.cycles))
    schedule.save(folder / "schedule.json")
    log, total = folder / "log.mcap", schedule.duration
    drive_rig(
        schedule,
        rig,
        rig_file,
        log,
        DriveConfig(
            folder / "design.json",
            on_time=lambda t: progress("driving and filming the virtual rig", min(max(t / total, 0.0), 1.0)),
            on_body=on_frame,
        ),
    )

    def show(frames: int, total: int) -> None:
        if frames < total:
            progress("tracking", frames / total)
        else:
            progress("predicting robots like this one", 0.0)

    with WorkerProcess("eldir_calibration.comparison.predictions") as worker:
        return prepare_report(
            log,
            design,
            worker,
            show,
            samples=config.samples,
        )


def choose_design(shortlist: Shortlist, seed: int) -> RankedDesign:
    """One of the designs whose fitness is about that of the first one: among those with most mass markers
    (m1 to m5) for the report to compare, seeds select sizes in turn. Samples hardly tell these designs
    apart, and so demos of several seeds show several robots."""
    shortlist.require_candidates("try another seed")
    first = shortlist.candidates[0]
    threshold = _ABOUT_AS_FAR * first.spread.fitness
    similar = [
        c
        for c in shortlist.candidates
        if c is first or (c.spread.fitness >= threshold > 0 and not c.is_doubtful)
    ]
    markers = [len(marked_masses(c.design.morphology)) for c in similar]
    equals = [c for c, n in zip(similar, markers, strict=True) if n == max(markers)]
    by_size = sorted(equals, key=lambda c: len(c.design.morphology.positions))
    return by_size[seed % len(by_size)]


def has_good_walker(archive: Archive[Walker]) -> bool:
    """Whether a robot walks as far as the demo requires, by enough samples to be sure."""
    return any(w.fitness >= _GOOD_FITNESS and w.samples >= MAX_SAMPLES for w in archive.ranked())


def folder_size(folder: Path) -> int:
    """Size of all files in a folder [byte]."""
    return sum(os.path.getsize(Path(base) / f) for base, _, files in os.walk(folder) for f in files)
