"""A recorded run: design, schedule and rig, and the log that holds them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from eldir.built.robot import BuiltRobot, build
from eldir.design import Design, Variant
from eldir.errors import InputError
from eldir.trajectory import Trajectory
from eldir_calibration.report.comparison import Motion
from eldir_calibration.report.runs import INTACT
from eldir_hardware.log.attachments import read_attachment
from eldir_hardware.log.bag import log_in
from eldir_hardware.log.fingerprint import fingerprint
from eldir_hardware.log.reader import RunLog, read_log
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.schedule import ActuationSchedule

_LATE = 0.25
"""A cycle counts as complete where at most this part of it is missing at the end."""
T = TypeVar("T")


@dataclass(frozen=True)
class RecordedRun:
    """A run of a robot on a rig under a schedule."""

    design: Design
    schedule: ActuationSchedule
    rig: Rig

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its marks."""
        return tuple(f"m{i + 1}" for i in range(len(self.design.marks)))

    @cached_property
    def robot(self) -> BuiltRobot:
        """The nominal robot, one plane."""
        return build(self.design.morphology, ballast=self.design.ballast / 2)

    @property
    def kind(self) -> tuple[str, str]:
        """Kind of the robot, as the report names it, and the detail."""
        variant = self.design.variant
        parts, details = [], []
        if variant.without_motor is not None:
            parts.append("without a motor")
            details.append(f"without motor {variant.without_motor}")
        if variant.ballast is not None:
            parts.append("with ballast")
            details.append(f"{variant.ballast.grams:g} g on mass {variant.ballast.mass}")
        return ", ".join(parts) or INTACT, ", ".join(details)


@dataclass(frozen=True)
class LoggedRun(RecordedRun):
    """A run, and the log of it."""

    log: RunLog

    def motion(self, trajectory: Trajectory) -> Motion:
        """The motion over the cycles that count, as many of them as the log holds completely."""
        s = self.schedule
        last = float(trajectory.times[-1]) if len(trajectory.times) else 0.0
        whole = min(s.cycles, int((last - s.start_of_cycles) / s.period_s + _LATE))
        if whole < 1:
            raise InputError(
                f"{self.log.path} ends before its first cycle that counts",
                code="log.too-short",
                expected=f"{s.start_of_cycles + s.period_s:.0f} s or more",
                found=f"{last:.1f} s; {self.ending}",
            )
        return Motion(trajectory, s.start_of_cycles, s.period_s, whole, self.robot.body_length)

    @property
    def moved_by(self) -> str:
        """The physics of a virtual rig, such as ", moved by MuJoCo 4.0.0"; empty for a real rig and in older
        logs."""
        return "".join(f", {message}" for _, part, message in self.log.statuses if part == "virtual rig")

    @property
    def ending(self) -> str:
        """How the run ended, according to its log."""
        said = [message for _, part, message in self.log.statuses if part == "player"]
        return f"its player last said: {said[-1]}" if said else "its player said nothing"


def read_run(path: Path) -> LoggedRun:
    """Reads a log with its design, schedule and rig; raises `InputError` where one of them is missing."""
    log = read_log(path)
    design = _attached(log, "design.json", Design.from_json)
    schedule = _attached(log, "schedule.json", ActuationSchedule.from_json)
    return LoggedRun(design, schedule, _attached(log, "rig.yaml", Rig.from_json), log)


def open_run(path: Path, design: Design) -> LoggedRun:
    """Reads a log as `read_run` does; raises `InputError` where it is of another design."""
    run = read_run(path)
    recorded = run.design
    if not _is_of(recorded, design):
        raise InputError(
            f"{path} was recorded with another design",
            code="log.other-design",
            expected="the design that the log holds as design.json, or one it was made from",
            found=f"another {'body' if recorded.genotype != design.genotype else 'controller or scene'}",
        )
    return run


def open_runs(paths: Sequence[Path], design: Design) -> list[LoggedRun]:
    """Reads logs as `open_run` does; raises `InputError`, before it reads any, where one is there twice."""
    named: dict[str, Path] = {}
    for path in paths:
        try:
            print_ = fingerprint(log_in(path))
        except OSError:
            continue  # `open_run` says why
        if print_ in named:
            same = path == named[print_]
            raise InputError(
                f"{path} is named twice" if same else f"{path} holds the same film as {named[print_]}",
                code="log.named-twice",
                expected="logs of different runs",
                remedy="name each log once",
            )
        named[print_] = path
    return [open_run(path, design) for path in paths]


def _is_of(recorded: Design, design: Design) -> bool:
    """Whether a log's robot is the design, or the design without a motor or with ballast."""
    if recorded == design:
        return True
    if recorded.variant == Variant() or design.variant != Variant():
        return False
    without = recorded.variant.without_motor
    springs = design.genotype.springs.copy()
    if without is not None:
        body = design.morphology
        springs[body.lattice_springs[body.active][without]] = False
    same_body = np.array_equal(recorded.genotype.triangles, design.genotype.triangles)
    return same_body and np.array_equal(recorded.genotype.springs, springs)


def _attached(log: RunLog, name: str, build: Callable[[Any], T]) -> T:
    found = read_attachment(log.attachments, log.path, name, build)
    if found is None:
        raise InputError(
            f"{log.path} has no {name}",
            code="log.not-attached",
            expected="a log of `eldir rig drive` with its design, schedule, rig and tags attached",
            found=", ".join(log.attachments) or "no attachments",
        )
    return found
