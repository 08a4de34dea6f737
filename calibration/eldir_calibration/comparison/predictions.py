"""Simulated motions of a report: the evolved one, and those of printed robots under a schedule; and the
range of motion cycle by cycle, while the markers of a run are still arriving."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from eldir.built.gait import CYCLES
from eldir.built.ground import surface_line
from eldir.built.heat import SpringState, heat
from eldir.built.motion import OK, PrintedMotion, drive
from eldir.built.robot import PrintedRobot, build
from eldir.built.samples import SAMPLES, IdentifiedRobots, NominalRobots, RobotDistribution
from eldir.built.scene import PrintedScene
from eldir.built.walking import stays_upright
from eldir.core.records import FloatArray, IntArray
from eldir.design import Design
from eldir.errors import EldirError, divergence_error
from eldir.parameters.springs import SpringParameters
from eldir.rollout import simulate_one
from eldir.trajectory import Trajectory
from eldir_calibration.comparison.film import PredictedBody, positions_at
from eldir_calibration.comparison.recorded_run import MeasuredConditions, RecordedRun
from eldir_calibration.report.comparison import Motion
from eldir_calibration.report.controls import sample_other_robots
from eldir_calibration.report.verdict import SampledMotions, prediction_interval
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import power_shares, scale_by_shares
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.vision.printed_ground import CORNER

_INTERVAL = 0.05  # of the predicted temperatures [s]
_UPRIGHT_STRIDE = 20  # intervals between two checks whether a sample stands
_BODY_STRIDE = 2  # intervals from one place of the whole body to the next
MAX_WALK_CYCLES = 20
"""Cycles over which `predict_walk` simulates a long schedule: about ten seconds of processor time."""
_WALK_INTERVAL = 0.5  # of the walk over time [s]
_NULL_CYCLES = 2
"""Other bodies are simulated for two cycles only, which takes half the time."""


class _SimulatedMotion(NamedTuple):
    """The motion of one robot."""

    motion: Motion | None
    """Over all cycles that count; None if the simulation blew up."""
    upright_cycles: int
    """Whole cycles of a sample until it falls, folds or buckles a coil; all of them where it need not stay
    upright."""

    @property
    def if_upright(self) -> Motion | None:
        """The motion over all cycles; None for a sample that fell."""
        return self.if_upright_for(0 if self.motion is None else self.motion.cycles)

    def if_upright_for(self, cycles: int) -> Motion | None:
        """The motion over the first cycles; None for a sample that fell in them."""
        if self.motion is None or self.upright_cycles < cycles:
            return None
        return replace(self.motion, cycles=cycles)


class PredictedMotions(NamedTuple):
    """Predicted motions for some runs."""

    evolved: Motion
    """Simulated motion of the first run's design."""
    own: list[Motion]
    """Prediction for the robot of each run."""
    others: list[Motion]
    """Motions of other bodies under the first run's schedule, without those whose simulation blew up."""
    before: Motion | None
    """Prediction for the first run's nominal robot, if `own` is of an identified robot."""
    sampled: list[_SimulatedMotion]
    """Motions of samples of the first run's robot: of the nominal one, or of the identified one."""
    body: PredictedBody
    """The whole body of the first prediction."""

    def samples(self, cycles: int) -> SampledMotions:
        """The samples over the first `cycles`, such as those that a film shows."""
        markers = len(self.own[0].trajectory.names)
        return SampledMotions.of([one.if_upright_for(cycles) for one in self.sampled], markers)


@dataclass(frozen=True)
class _Simulation:
    """A robot that is to be simulated."""

    run: RecordedRun
    """The run whose schedule it follows."""
    robot: PrintedRobot
    marker_masses: IntArray
    free: tuple[float, float]
    """Cold and hot free length of its springs [m]."""
    lengths: FloatArray
    """Free lengths of the motors at every interval [m], shape (K + 1, A)."""
    cycles: int
    body_length: float
    """Body length of the robot [m]."""
    must_stay_upright: bool = False
    """Whether it counts only if it stays upright."""


def predict_runs(
    runs: Sequence[RecordedRun], scene: PrintedScene | None = None, samples: int = SAMPLES
) -> PredictedMotions:
    """Every motion that a report shows beside the camera's, simulated as one batch: of the nominal robots, or
    of the identified robot of a scene, with its parts as found, on the rig of each run. `samples`: of the
    first run's robot."""
    simulations = [_prepare_run(run, scene) for run in runs]
    sampled = _prepare_samples(runs[0], scene, samples)
    others = sample_other_robots(runs[0].design, runs[0].rig.nominal_robot())
    simulations += [_prepare_other(simulations[0], *other) for other in others]
    if scene is not None:
        simulations.append(_prepare_run(runs[0], None))
    every, body = _simulate([*simulations, *sampled])
    motions = [one.motion for one in every[: len(simulations)]]
    own, other_motions = motions[: len(runs)], motions[len(runs) :]
    before = other_motions.pop() if scene is not None else None
    if None in own or (scene is not None and before is None):
        raise divergence_error("the predicted motion")
    return PredictedMotions(
        simulate_evolved(runs[0]),
        [m for m in own if m],
        [m for m in other_motions if m],
        before,
        every[len(simulations) :],
        body,
    )


class LivePrediction(NamedTuple):
    """The prediction for a run that begins."""

    motions: dict[str, Motion]
    """The motions of the markers without a camera: `simulated` as evolved, and `predicted` for this
    schedule."""
    body: PredictedBody
    """The motion of all masses of the predicted robot."""


def predict_live(
    design: Design, schedule: ActuationSchedule, rig: Rig, room_c: float | None = None
) -> LivePrediction:
    """Predict a run in seconds; `room_c`: the air that was measured before it [C]. Raises `EldirError` where
    the simulation fails."""
    run = RecordedRun(design, schedule, rig, MeasuredConditions(room_c))
    (predicted,), body = _simulate([_prepare_run(run, None)])
    if predicted.motion is None:
        raise divergence_error("the predicted motion")
    return LivePrediction({"simulated": simulate_evolved(run), "predicted": predicted.motion}, body)


def predict_body(run: RecordedRun, scene: PrintedScene | None = None) -> PredictedBody:
    """The motion of the whole robot under the schedule of a run: of the nominal one, or of the identified one
    of a scene. Raises `EldirError` where the simulation fails."""
    (predicted,), body = _simulate([_prepare_run(run, scene)])
    if predicted.motion is None:
        raise divergence_error("the predicted motion")
    return body


def predict_walk(run: RecordedRun, samples: int = SAMPLES) -> FloatArray:
    """The predicted walk over time, from the samples and with the 95 % interval of `predict_runs`.

    Rows of time since the start of the schedule [s], mean, lower and upper end of the interval [body lengths
    since the first cycle that counts], shape (n, 4): to the end of the schedule or of its first
    `MAX_WALK_CYCLES`. Raises `EldirError` if fewer than two samples stay upright.
    """
    schedule = replace(run.schedule, cycles=min(run.schedule.cycles, MAX_WALK_CYCLES))
    every, _ = _simulate(_prepare_samples(replace(run, schedule=schedule), None, samples))
    walks = [one.if_upright.advance() for one in every if one.if_upright is not None]
    if len(walks) < 2:
        raise EldirError(
            f"no prediction: {samples - len(walks)} of {samples} sampled robots fall over or fold"
        )
    count = round(schedule.cycles * schedule.period_s / _WALK_INTERVAL)
    cycles = np.linspace(0.0, schedule.cycles, count + 1)
    moved = np.array([np.interp(cycles, *walk) for walk in walks])
    found = [prediction_interval(values) for values in moved.T]
    times = schedule.start_of_cycles + cycles * schedule.period_s
    return np.array([(t, f.mean, f.low, f.high) for t, f in zip(times, found, strict=True)])


def simulate_evolved(run: RecordedRun) -> Motion:
    """The closed-loop rollout: its last five whole cycles of the pattern generators."""
    design = run.design
    rollout = simulate_one(design.morphology, design.controller, design.scene)
    if rollout.status != OK:
        raise divergence_error(f"step {rollout.status} of the design's rollout")
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


def _prepare_run(run: RecordedRun, scene: PrintedScene | None) -> _Simulation:
    body, ballast = run.design.morphology, run.design.ballast / 2
    nominal, _ = run.nominal
    whole = nominal if scene is None else run.on_rig(scene).robot_of(run.design)
    robot = build(body, whole, ballast=ballast)
    lengths = _free_lengths(run, whole.motor_springs(body.motors), body.motor_hubs)
    s, free = run.schedule, whole.free_lengths
    return _Simulation(run, robot, run.design.marks, free, lengths, s.cycles, run.robot.body_length)


def _prepare_samples(run: RecordedRun, scene: PrintedScene | None, count: int) -> list[_Simulation]:
    """Samples of the robot of a run; with the schedule's seed they are those that `eldir gait` simulated, but
    for what was measured in the run."""
    design, body = run.design, run.design.morphology
    if scene is None:
        nominal, tolerances = run.nominal
        robots: RobotDistribution = NominalRobots(
            body, nominal, design.ballast / 2, design.printed_terrain, tolerances
        )
    else:
        here = run.on_rig(scene)
        robots = IdentifiedRobots.of(design, here, [film.gait for film in here.filmed_of(design)])
    found = []
    for one in robots.samples(count, run.schedule.provenance.seed or 0):
        built = build(body, one, ballast=design.ballast / 2)
        lengths = _free_lengths(run, one.motor_springs(body.motors), body.motor_hubs)
        free = robots.free_lengths_of(one)
        found.append(
            _Simulation(run, built, design.marks, free, lengths, run.schedule.cycles, built.body_length, True)
        )
    return found


def _prepare_other(own: _Simulation, body: PrintedRobot, marker_masses: IntArray) -> _Simulation:
    s = own.run.schedule
    cycles = min(s.cycles, _NULL_CYCLES)
    end = int(np.ceil((s.start_of_cycles + cycles * s.period_s) / _INTERVAL)) + 1
    return _Simulation(own.run, body, marker_masses, own.free, own.lengths[:end], cycles, body.body_length)


def _simulate(simulations: Sequence[_Simulation]) -> tuple[list[_SimulatedMotion], PredictedBody]:
    """Their motions on the ground of the first one's design, and the first one's whole body."""
    terrain = simulations[0].run.design.printed_terrain
    moved = drive(
        [t.robot for t in simulations],
        [t.lengths for t in simulations],
        _INTERVAL,
        free=[t.free for t in simulations],
        terrain=terrain,
    )
    motions: list[_SimulatedMotion] = []
    for one, found in zip(simulations, moved, strict=True):
        names = one.run.names
        path = Trajectory(names, found.times, found.positions[:, one.marker_masses[: len(names)]])
        s = one.run.schedule
        motion = Motion(path, s.start_of_cycles, s.period_s, one.cycles, one.body_length)
        upright = _count_upright_cycles(one, found) if one.must_stay_upright else one.cycles
        motions.append(_SimulatedMotion(motion if found.status == OK else None, upright))
    first, whole = simulations[0], moved[0]
    shown = slice(None, None, _BODY_STRIDE)
    body = PredictedBody(
        whole.times[shown],
        whole.positions[shown],
        first.run.design.morphology.springs,
        first.marker_masses,
        None if terrain is None else surface_line(terrain, first.robot.positions, CORNER),
    )
    return motions, body


def _count_upright_cycles(one: _Simulation, found: PrintedMotion) -> int:
    """Whole cycles until a sample falls, folds or buckles a coil; 0 if its simulation blew up."""
    schedule = one.run.schedule

    def is_upright(end: int | None) -> bool:
        seconds = slice(None, end, _UPRIGHT_STRIDE)
        part = replace(found, positions=found.positions[seconds], rotations=found.rotations[seconds])
        return stays_upright(one.robot, part, one.lengths[seconds])

    if is_upright(None):
        return one.cycles
    ends = [schedule.start_of_cycles + n * schedule.period_s for n in range(1, one.cycles)]
    frames = np.searchsorted(found.times, ends, side="right").tolist()
    return next((n for n, end in enumerate(frames) if not is_upright(end)), len(frames))


def _free_lengths(run: RecordedRun, springs: Sequence[SpringParameters], hubs: IntArray) -> FloatArray:
    """Free lengths of the motors by the thermal model, every interval [m]. A control robot may follow the
    schedule of the intact one: channels of a motor that it has not move nothing."""
    motors = len(springs)
    channels, states = run.schedule.sampled(_INTERVAL)
    motors_by_channel = {c.channel: c.spring for c in run.rig.channels}
    # Both faces heat alike in the model; a plane's motor is on while either of its channels is.
    power = scale_by_shares(states.astype(float), power_shares(run.rig, run.rig.spring_parameters()))
    on = np.zeros((len(states), motors))
    for column, channel in enumerate(channels):
        if (motor := motors_by_channel[channel]) < motors:
            on[:, motor] = np.maximum(on[:, motor], power[:, column])
    cold = SpringState(np.array([s.ambient for s in springs]), np.ones(motors))
    lengths = heat(on, _INTERVAL, springs, cold, hubs=hubs).length
    return np.concatenate([[[s.cold_length for s in springs]], lengths])


class CycleRanges(NamedTuple):
    """Ranges of motion and displacement in one cycle of a run."""

    cycle: int
    """Number of the cycle, from 1."""
    ranges: dict[str, FloatArray]
    """Vertical range of motion [m] of each marker (K,), by kind: `tracked`, and `simulated` and `predicted`
    as soon as they are known."""
    displacement: float
    """Tracked displacement in the cycle [body lengths]."""


class LiveRangeOfMotion:
    """Ranges of motion of one run, from the markers as they arrive."""

    def __init__(self, design: Design, schedule: ActuationSchedule):
        self.prediction: LivePrediction | None = None
        """The motions without a camera; set it when they are known."""
        self._body_length = build(design.morphology).body_length
        self._schedule = schedule
        self._times: list[float] = []
        self._positions: list[FloatArray] = []
        self._cycle = 0

    def update(self, t: float, names: tuple[str, ...], positions: FloatArray) -> CycleRanges | None:
        """Add the positions (K, 2) [m] of the markers at `t` [s since the schedule's start].

        Returns the ranges of the latest cycle when `t` is the first time after its end, else None; also
        None where the positions do not cover the cycle. A marker that was not seen has the range NaN. Times
        before the start and out of order are ignored.
        """
        if t < 0 or (self._times and t <= self._times[-1]):
            return None
        self._times.append(t)
        self._positions.append(positions)
        whole = int((t - self._schedule.start_of_cycles) / self._schedule.period_s)
        complete = min(whole, self._schedule.cycles)
        if complete <= self._cycle:
            return None
        self._cycle = complete
        return self._latest(names)

    def _latest(self, names: tuple[str, ...]) -> CycleRanges | None:
        begin = self._schedule.start_of_cycles + (self._cycle - 1) * self._schedule.period_s
        trajectory = Trajectory(names, np.array(self._times), np.array(self._positions))
        motions = {} if self.prediction is None else self.prediction.motions
        try:
            tracked = Motion(trajectory, begin, self._schedule.period_s, 1, self._body_length)
            # The simulated motion has other cycles than the schedule: its last one counts.
            ranges = {
                kind: motion.vertical_ranges()[
                    -1 if kind == "simulated" else min(self._cycle, motion.cycles) - 1
                ]
                for kind, motion in {**motions, "tracked": tracked}.items()
            }
            return CycleRanges(self._cycle, ranges, tracked.displacement() / CYCLES)
        except EldirError:  # the positions do not cover the cycle
            return None

    def predicted_masses(self, t: float) -> FloatArray | None:
        """Positions (M, 2) [m] of all masses of the predicted robot at `t` [s since the schedule's start].

        It is moved forward to where the markers were first seen. None where there is no prediction."""
        if self.prediction is None or not self._times or not 0 <= t <= self._schedule.duration:
            return None
        body, first = self.prediction.body, self._positions[0]
        begin = positions_at(body, self._times[0])[body.marker_masses[: len(first)]]
        ahead = first[:, 0] - begin[:, 0]
        if not np.isfinite(ahead).any():
            return None
        return positions_at(body, t) + np.array([float(np.nanmean(ahead)), 0.0])
