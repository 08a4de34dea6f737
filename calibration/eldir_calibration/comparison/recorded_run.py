"""A recorded run: design, schedule and rig, and the log that holds them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from eldir.built.robot import PrintedRobot, build
from eldir.built.scene import PrintedScene
from eldir.core.records import FloatArray
from eldir.design import Design, Variant
from eldir.errors import InputError
from eldir.parameters.robot import RobotParameters
from eldir.parameters.tolerances import RigTolerances
from eldir.parameters.uncertain import PARAMETERS
from eldir.trajectory import Trajectory
from eldir_calibration.comparison.meters import read_meters
from eldir_calibration.report.comparison import Motion, max_missing_time
from eldir_calibration.report.controls import INTACT
from eldir_hardware.log.mcap_file import find_log, fingerprint
from eldir_hardware.log.messages import MOVED_BY, PLAYED_TO_END, VIRTUAL_RIG
from eldir_hardware.log.reader import RunLog, read_attachment, read_log
from eldir_hardware.planning.compiler import extract_gait
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.schedule import ActuationSchedule

_SAME_INSTANT = 0.005  # times of schedules are rounded to milliseconds [s]
_PAUSED = "paused"  # a message of the player begins with it
_ROOM_ERROR = 1.0
"""How far the air may be from what was measured before the run, two standard deviations [C]: a thermometer is
right to half a degree, and a room changes."""
T = TypeVar("T")


@dataclass(frozen=True)
class MeasuredConditions:
    """What was measured of a run's heat instead of assumed."""

    room_c: float | None = None
    """Temperature of the air before the run [C]; None if it was not measured."""
    current_a: float | None = None
    """Mean current of the springs while they heat [A]; None if it was not measured."""
    current_error: float = 0.0
    """Largest relative error of that current, as that of any measured spring."""
    partial: str = ""
    """How many of the heated springs were measured (`MeterReadings.partial`); empty: all."""

    def apply(
        self, robot: RobotParameters, tolerances: RigTolerances
    ) -> tuple[RobotParameters, RigTolerances]:
        """The nominal robot with what was measured, and what it leaves open."""
        springs = robot.springs.in_air(self.room_c)
        if self.room_c is not None:
            low, high = self.room_c - _ROOM_ERROR, self.room_c + _ROOM_ERROR
            tolerances = replace(tolerances, ambient_min=low, ambient_max=high)
        if self.current_a is not None:
            current = PARAMETERS["current"]
            change = math.log(self.current_a / float(springs.current(0.0)))
            springs = current.at(springs, change / current.spread)
            if not self.partial:  # an output that was not measured may differ as the rig file says
                tolerances = replace(tolerances, current=min(tolerances.current, self.current_error))
        return replace(robot, springs=springs), tolerances

    def __str__(self) -> str:
        found = []
        if self.room_c is not None:
            found.append(f"air {self.room_c:g} C")
        if self.current_a is not None:
            found.append(f"current {self.current_a:.2f} A{self.partial} (within {self.current_error:.1%})")
        return ", ".join(found) or "neither air nor current"


@dataclass(frozen=True)
class RecordedRun:
    """A run of a robot on a rig under a schedule."""

    design: Design
    schedule: ActuationSchedule
    rig: Rig
    measured: MeasuredConditions = MeasuredConditions()

    @property
    def nominal(self) -> tuple[RobotParameters, RigTolerances]:
        """The nominal robot on this rig, and how far its rig may be from it, after what was measured."""
        return self.measured.apply(self.rig.nominal_robot(), self.rig.spring_tolerances())

    def on_rig(self, scene: PrintedScene) -> PrintedScene:
        """A scene with the supply of this rig, in the air of the run. Raises `InputError` for other
        springs."""
        return scene.on_rig(self.rig.spring_parameters().in_air(self.measured.room_c))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its markers."""
        return tuple(f"m{i + 1}" for i in range(len(self.design.marks)))

    @cached_property
    def robot(self) -> PrintedRobot:
        """The nominal robot, one plane."""
        return build(self.design.morphology, ballast=self.design.ballast / 2)

    @property
    def kind(self) -> tuple[str, str]:
        """Kind of the robot, as the report names it, and the detail."""
        variant, parts = self.design.variant, []
        if variant.without_motor is not None:
            parts.append("without a motor")
        if variant.ballast is not None:
            parts.append("with ballast")
        return ", ".join(parts) or INTACT, ", ".join(variant.changes)

    def describe_other_heating(self, other: RecordedRun) -> str:
        """How it was heated otherwise than another run, in words; empty if it was not. Only motors that both
        schedules name count."""
        own, others, found = self.schedule, other.schedule, []
        if own.period_s != others.period_s:
            found.append(f"a period of {own.period_s:g} s instead of {others.period_s:g} s")
        elif not _have_the_same_pulses(own, others):
            found.append("other pulses")
        limits = self.rig.supply.current_limit_a, other.rig.supply.current_limit_a
        if limits[0] != limits[1]:
            found.append("a current limit of {} A instead of {} A".format(*limits))
        return " and ".join(found)


def _have_the_same_pulses(one: ActuationSchedule, other: ActuationSchedule) -> bool:
    """Whether two schedules of the same period heat the motors that both name alike, wherever the period
    begins; without a gait, by the same events."""
    a, b = _pulses(one), _pulses(other)
    if a is None or b is None:
        return one.events == other.events
    both = sorted(a.keys() & b.keys())
    starts, lengths = np.array([[a[k], b[k]] for k in both]).reshape(-1, 2, 2).transpose(2, 1, 0)
    shift = (starts[0] - starts[1])[lengths.min(axis=0) > 0]
    apart = np.abs((shift - shift[:1] + one.period_s / 2) % one.period_s - one.period_s / 2)
    return bool(np.all(apart <= _SAME_INSTANT) and np.all(np.abs(lengths[0] - lengths[1]) <= _SAME_INSTANT))


def _pulses(schedule: ActuationSchedule) -> dict[int, tuple[float, float]] | None:
    """Start and length of the pulse of each motor [s], by its spring in the design, or its number where the
    schedule does not name it; None for a schedule without a gait."""
    gait = extract_gait(schedule)
    if gait is None:
        return None
    names = schedule.springs or range(len(gait.phase))
    return {
        spring: (gait.period * phase, gait.period * duty)
        for spring, phase, duty in zip(names, gait.phase.tolist(), gait.duty.tolist(), strict=True)
    }


@dataclass(frozen=True)
class LoggedRun(RecordedRun):
    """A run, and the log of it."""

    log: RunLog = field(kw_only=True)

    def without_log(self) -> RecordedRun:
        """The same run for another process, without what is large."""
        return RecordedRun(*(getattr(self, part.name) for part in fields(RecordedRun)))

    def motion(self, trajectory: Trajectory) -> Motion:
        """The motion over the cycles that count, as many of them as the log holds completely and before any
        pause."""
        s = self.schedule
        last = float(trajectory.times[-1]) if len(trajectory.times) else 0.0
        end = last + max_missing_time(trajectory.times)
        if self.paused_s is not None:
            end = last = min(end, self.paused_s)
        complete = min(s.cycles, int((end - s.start_of_cycles) / s.period_s + 1e-9))
        if complete < 1:
            raise InputError(
                f"{self.log.path} holds no complete cycle that counts",
                code="log.too-short",
                expected=f"{s.start_of_cycles + s.period_s:.0f} s or more",
                found=f"{last:.1f} s; {self.ending}",
            )
        return Motion(trajectory, s.start_of_cycles, s.period_s, complete, self.robot.body_length)

    def contact_shares(self, interval: float) -> FloatArray:
        """Share of each `interval` [s] in which each motor's contacts were closed, shape (steps, motors)."""
        if not len(self.log.relay_times):
            raise InputError(
                f"{self.log.path} does not say when contacts closed",
                code="log.no-contacts",
                expected="read-backs of the relays",
            )
        motors = self.design.morphology.motors
        edges = np.arange(int(np.ceil(self.schedule.duration / interval)) + 1) * interval
        closed, faces = np.zeros((motors, len(edges) - 1)), np.zeros(motors)
        for entry in self.rig.channels:
            if entry.spring < motors:
                times = self._switching_times(entry.channel)
                # What is closed at the end stays closed.
                until = np.append(times, [np.inf] * (len(times) % 2)).reshape(-1, 2, 1)
                since, until = np.clip(until[:, 0], 0, edges[-1]), np.clip(until[:, 1], 0, edges[-1])
                overlap = np.minimum(until, edges[1:]) - np.maximum(since, edges[:-1])
                closed[entry.spring] += np.maximum(overlap, 0.0).sum(axis=0) / interval
                faces[entry.spring] += 1
        return (closed / np.maximum(faces, 1)[:, None]).T

    def _switching_times(self, channel: int) -> FloatArray:
        """Times at which a channel closed and opened, alternately [s].

        Two read-backs enclose a switching only to half a second, in which a spring may get a centimetre
        longer. So the switching counts at its time in the schedule, if that lies between them. Otherwise
        (after a pause, or where a contact stuck) it counts in the middle.
        """
        states = np.concatenate([[False], self.log.relays[:, channel - 1]])
        times = np.concatenate([self.log.relay_times[:1], self.log.relay_times])
        scheduled = [(t, changes[channel]) for t, changes in self.schedule.switchings() if channel in changes]
        switchings = []
        for i in np.flatnonzero(states[1:] != states[:-1]):
            before, after = times[i], times[i + 1]
            inside = [t for t, on in scheduled if on == states[i + 1] and before <= t <= after]
            switchings.append(inside[0] if inside else (before + after) / 2)
        return np.array(switchings)

    @property
    def physics_note(self) -> str:
        """Whether it was a rehearsal, and the physics of a virtual rig, such as ", moved by MuJoCo 4.0.0";
        empty for a run of a real rig and in older logs."""
        rehearsal = ", a rehearsal on an emulated board" if self.log.is_dry_run else ""
        return rehearsal + "".join(f", {message}" for message in self._virtual_rig_messages)

    @property
    def impossible_motion(self) -> str:
        """What the robot of a virtual rig did that a printed one cannot do; empty if nothing was seen."""
        return "; ".join(m for m in self._virtual_rig_messages if not m.startswith(MOVED_BY))

    @property
    def _virtual_rig_messages(self) -> list[str]:
        return [message for _, part, message in self.log.statuses if part == VIRTUAL_RIG]

    @property
    def paused_s(self) -> float | None:
        """When the run was first paused [s]; None if it was not. Later cycles are not where the schedule has
        them."""
        return next((t for t, message in self._player_messages if message.startswith(_PAUSED)), None)

    def require_unpaused(self, remedy: str) -> None:
        """Raise `InputError` for a run that was paused."""
        if self.paused_s is not None:
            raise InputError(
                f"{self.log.path} is of a run that was paused at {self.paused_s:.1f} s",
                code="adapt.paused",
                expected="a run without a pause: robots are compared over the schedule's cycles",
                remedy=remedy,
            )

    def describe_missing_cycles(self, cycles: int) -> str:
        """A sentence for a reader of a film of which so many cycles count; empty where all do and the run was
        played to its end."""
        if cycles == self.schedule.cycles and not self.is_incomplete:
            return ""
        return f"{cycles} of {self.schedule.cycles} cycles of {self.log.path.name} count; {self.ending}."

    @property
    def is_incomplete(self) -> bool:
        """Whether its player says that it was paused, or did not play to the end."""
        messages = self._player_messages
        return self.paused_s is not None or (bool(messages) and messages[-1][1] != PLAYED_TO_END)

    @property
    def ending(self) -> str:
        """How the run ended, according to its log."""
        if not self._player_messages:
            return "no message of its player"
        paused = (
            "" if self.paused_s is None else f"paused at {self.paused_s:.1f} s, later cycles do not count; "
        )
        return f"{paused}last message of its player: {self._player_messages[-1][1]}"

    @property
    def _player_messages(self) -> list[tuple[float, str]]:
        """Messages of its player with their times [s]."""
        return [(t, message) for t, part, message in self.log.statuses if part == "player"]


def read_run(path: Path) -> LoggedRun:
    """Reads a log with its design, schedule and rig; raises `InputError` where one of them is missing."""
    log = read_log(path)
    design = _require_attachment(log, "design.json", Design.from_json)
    schedule = _require_attachment(log, "schedule.json", ActuationSchedule.from_json)
    rig = _require_attachment(log, "rig.yaml", Rig.from_json)
    return LoggedRun(design, schedule, rig, _measured_conditions(log, rig), log=log)


def _measured_conditions(log: RunLog, rig: Rig) -> MeasuredConditions:
    """What the log measured of the air and of the current."""
    found = MeasuredConditions(room_c=log.room_c)
    readings = None if rig.supply.outputs == "shared" else read_meters([(log, rig)], hot=False)
    if readings is None:
        return found
    return MeasuredConditions(log.room_c, readings.current_a, readings.spring_error, readings.partial)


def open_run(path: Path, design: Design) -> LoggedRun:
    """Reads a log as `read_run` does; raises `InputError` where it is of another design. Parts that are not
    the kit's are those of the log's design, or of the given one where the log does not know them."""
    run = read_run(path)
    recorded = run.design
    if not _is_variant(replace(recorded, other_parts=design.other_parts), design):
        raise InputError(
            f"{path} was recorded with another design",
            code="log.other-design",
            expected="the design that the log holds as design.json, or one it was made from",
            found=f"another {_name_difference(recorded, design)}",
        )
    return replace(run, design=replace(recorded, other_parts=recorded.other_parts or design.other_parts))


def _name_difference(recorded: Design, design: Design) -> str:
    if recorded.genotype != design.genotype:
        return "body"
    return "ground" if recorded.printed_terrain != design.printed_terrain else "controller or scene"


def open_runs(paths: Sequence[Path], design: Design) -> list[LoggedRun]:
    """Reads logs as `open_run` does; raises `InputError`, before it reads any, where one is there twice."""
    paths_by_digest: dict[str, Path] = {}
    for path in paths:
        try:
            digest = fingerprint(find_log(path))
        except OSError:
            continue  # `open_run` says why
        if digest in paths_by_digest:
            same = path == paths_by_digest[digest]
            raise InputError(
                f"{path} is named twice"
                if same
                else f"{path} holds the same film as {paths_by_digest[digest]}",
                code="log.named-twice",
                expected="logs of different runs",
                remedy="name each log once",
            )
        paths_by_digest[digest] = path
    return [open_run(path, design) for path in paths]


def _is_variant(recorded: Design, design: Design) -> bool:
    """Whether a log's robot is the design, or the design without a motor or with ballast."""
    if recorded == design:
        return True
    if recorded.variant == Variant() or design.variant != Variant():
        return False
    if recorded.printed_terrain != design.printed_terrain:
        return False
    without = recorded.variant.without_motor
    springs = design.genotype.springs.copy()
    if without is not None:
        body = design.morphology
        springs[body.lattice_springs[body.active][without]] = False
    same_body = np.array_equal(recorded.genotype.triangles, design.genotype.triangles)
    return same_body and np.array_equal(recorded.genotype.springs, springs)


def _require_attachment(log: RunLog, name: str, build: Callable[[Any], T]) -> T:
    found = read_attachment(log.attachments, log.path, name, build)
    if found is None:
        raise InputError(
            f"{log.path} has no {name}",
            code="log.not-attached",
            expected="a log of `eldir rig drive` with its design, schedule, rig and tags attached",
            found=", ".join(log.attachments) or "no attachments",
        )
    return found
