"""Simulated motions of a report: the evolved one, and those of built robots under a schedule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calibration.report.comparison import CYCLES, Motion
from eldir.built.heat import SpringState, heat
from eldir.built.motion import FINE, drive
from eldir.built.robot import BuiltRobot, build
from eldir.built.scene import BuiltScene
from eldir.core.records import FloatArray, IntArray
from eldir.design import Design
from eldir.errors import EldirError
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir.rollout import simulate
from eldir.trajectory import Trajectory
from hardware.analysis.null_designs import other_robots
from hardware.analysis.recorded_run import RecordedRun
from hardware.rig.configuration import Rig
from hardware.schedule import ActuationSchedule

_INTERVAL = 0.05  # of the predicted temperatures [s]
_NULL_CYCLES = 2
"""Other bodies are simulated for two cycles only, which takes half the time."""


class Predicted(NamedTuple):
    """Predicted motions for some runs."""

    evolved: Motion
    """Simulated motion of the first run's design."""
    own: list[Motion]
    """Prediction for the robot of each run."""
    others: list[Motion]
    """Motions of other bodies under the first run's schedule, without those whose simulation blew up."""
    before: Motion | None
    """Prediction for the first run's nominal robot, if `own` is of an identified robot."""


@dataclass(frozen=True)
class _Simulation:
    """A robot that is to be simulated."""

    run: RecordedRun
    """The run whose schedule it follows."""
    robot: BuiltRobot
    marks: IntArray
    springs: SpringParameters
    """Springs of the robot as a whole."""
    lengths: FloatArray
    """Free lengths of the motors at every interval [m], shape (K + 1, A)."""
    cycles: int
    body_length: float
    """Body length of the robot [m]."""


def predict_runs(runs: Sequence[RecordedRun], scene: BuiltScene | None = None) -> Predicted:
    """Every motion that a report shows beside the camera's, simulated as one batch: of the nominal robots, or
    of the identified robot of a scene, with its parts as found."""
    simulations = [_own(run, scene) for run in runs]
    simulations += [_other(simulations[0], body, marks) for body, marks in other_robots(runs[0].design)]
    if scene is not None:
        simulations.append(_own(runs[0], None))
    motions = _drive(simulations)
    own, others = motions[: len(runs)], motions[len(runs) :]
    before = others.pop() if scene is not None else None
    if None in own or (scene is not None and before is None):
        raise EldirError("the predicted motion blew up", remedy="choose another design")
    return Predicted(evolved(runs[0]), [m for m in own if m], [m for m in others if m], before)


def motions_without_camera(design: Design, schedule: ActuationSchedule, rig: Rig) -> tuple[Motion, Motion]:
    """The evolved motion of the design's marks, and the one predicted for exactly this schedule."""
    run = RecordedRun(design, schedule, rig)
    (predicted,) = _drive([_own(run, None)])
    if predicted is None:
        raise EldirError("the predicted motion blew up", remedy="choose another design")
    return evolved(run), predicted


def evolved(run: RecordedRun) -> Motion:
    """The closed-loop rollout: its last five whole cycles of the pattern generators."""
    design = run.design
    (rollout,) = simulate([design.morphology], [design.controller], design.scene)
    if rollout.status != FINE:
        raise EldirError(
            f"the design's rollout blew up at step {rollout.status}", remedy="choose another design"
        )
    times = np.arange(len(rollout.positions)) * design.scene.dt
    period = 2 * np.pi / design.scene.omega
    cycles = min(CYCLES, int(times[-1] / period))
    # In simulation the ground lies at another height and the body at another place than on the table.
    placed = rollout.positions[:, design.marks] - rollout.positions[0].min(axis=0)
    return Motion(
        Trajectory(run.names, times, placed),
        float(times[-1] - cycles * period),
        period,
        cycles,
        design.morphology.body_length,
        run.robot.parameters.scale,
    )


def _joints(rig: Rig) -> BuiltParameters:
    """A nominal robot with hubs; with pins where the engine moves a virtual one, which has them."""
    pinned = rig.kind == "virtual" and rig.virtual.physics == "eldir"
    return BuiltParameters() if pinned else BuiltParameters().with_hubs()


def _own(run: RecordedRun, scene: BuiltScene | None) -> _Simulation:
    body, ballast = run.design.morphology, run.design.ballast / 2
    nominal = RobotParameters(_joints(run.rig), run.rig.spring_parameters())
    whole = nominal if scene is None else scene.robot_of(run.design)
    robot = build(body, whole, ballast=ballast)
    lengths = _lengths(run, whole.springs_of(body.motors))
    s = run.schedule
    return _Simulation(run, robot, run.design.marks, whole.springs, lengths, s.cycles, run.robot.body_length)


def _other(own: _Simulation, body: BuiltRobot, marks: IntArray) -> _Simulation:
    s = own.run.schedule
    cycles = min(s.cycles, _NULL_CYCLES)
    end = int(np.ceil((s.start_of_cycles + cycles * s.period_s) / _INTERVAL)) + 1
    return _Simulation(own.run, body, marks, own.springs, own.lengths[:end], cycles, body.body_length)


def _drive(simulations: Sequence[_Simulation]) -> list[Motion | None]:
    """Their motions over the cycles that count; None for one that blew up."""
    moved = drive(
        [t.robot for t in simulations],
        [t.lengths for t in simulations],
        _INTERVAL,
        free=[(t.springs.cold_length, t.springs.hot_length) for t in simulations],
    )
    motions: list[Motion | None] = []
    for one, found in zip(simulations, moved, strict=True):
        names = one.run.names
        path = Trajectory(names, found.times, found.positions[:, one.marks[: len(names)]])
        s = one.run.schedule
        motion = Motion(path, s.start_of_cycles, s.period_s, one.cycles, one.body_length)
        motions.append(motion if found.status == FINE else None)
    return motions


def _lengths(run: RecordedRun, springs: Sequence[SpringParameters]) -> FloatArray:
    """Free lengths of the motors by the thermal model, every interval [m]."""
    motors = len(springs)
    channels, states = run.schedule.sampled(_INTERVAL)
    motor_of = {c.channel: c.spring for c in run.rig.channels}
    # Both faces heat alike in the model; a plane's motor is on while either of its channels is.
    on = np.zeros((len(states), motors), bool)
    for column, channel in enumerate(channels):
        on[:, motor_of[channel]] |= states[:, column]
    cold = SpringState(np.array([s.ambient for s in springs]), np.ones(motors))
    lengths = heat(on, _INTERVAL, springs, cold).length
    return np.concatenate([[[s.cold_length for s in springs]], lengths])
