"""From a log alone to the three motions of a report."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import TypeVar

import numpy as np
import yaml

from calibration.comparison import CYCLES, Motion
from calibration.report import Heating, ReportInput
from eldir import __version__
from eldir.built import FINE, BuiltRobot, build, drive
from eldir.design import Design
from eldir.errors import EldirError, InputError
from eldir.rollout import simulate
from eldir.sma import SpringState, heat
from eldir.trajectory import Trajectory
from hardware.log.reader import RunLog, read_log
from hardware.rig import Rig
from hardware.schedule import ActuationSchedule
from hardware.vision.pipeline import overlay, plane_of, track
from hardware.vision.sources import open_source

_INTERVAL = 0.05  # of the predicted temperatures [s]
_POOR_WALK = 0.3  # body lengths per five cycles below which a prediction is explained
T = TypeVar("T")


def analyse(path: Path, design: Design, seen: Callable[[int], None] = lambda frames: None) -> ReportInput:
    """Track the frames of a log, roll the design out, predict its schedule: all that a report shows."""
    log = read_log(path)
    recorded = _attached(log, "design.json", lambda b: Design.from_json(json.loads(b)))
    if recorded != design:
        raise InputError(
            f"{path} was recorded with another design",
            expected="the design that the log holds as design.json",
            found=f"another {'body' if recorded.genotype != design.genotype else 'controller or scene'}",
        )
    schedule = _attached(log, "schedule.json", lambda b: ActuationSchedule.from_json(json.loads(b)))
    rig = _attached(log, "rig.yaml", lambda b: Rig.model_validate(yaml.safe_load(b)))
    if log.frame_count == 0:
        raise InputError(f"{path} holds no frames", remedy="record with a camera in the rig file")
    marks = design.marks
    names = tuple(f"m{i + 1}" for i in range(len(marks)))
    tracked, picture = _filmed(path, names, design, marks, seen)
    simulated, predicted = motions_without_camera(design, schedule, rig)
    span = (schedule.start_of_cycles, schedule.period_s, schedule.cycles)
    return ReportInput(
        title=f"Simulated, predicted and filmed: {path.name}",
        simulated=simulated,
        predicted=predicted,
        tracked=Motion(tracked, *span, predicted.body_length),
        heating=Heating(
            log.relay_times, log.relays, log.channels, log.temperature_times, log.temperatures, log.springs
        ),
        overlay=picture,
        remarks=_remarks(schedule),
        provenance={
            "log": path.name,
            "rig": f"{rig.name} ({rig.kind})",
            "schedule": f"{schedule.cycles} cycles of {schedule.period_s:g} s",
            "frames": str(log.frame_count),
            "eldir": __version__,
        },
    )


def _filmed(
    path: Path, names: tuple[str, ...], design: Design, marks: np.ndarray, seen: Callable[[int], None]
) -> tuple[Trajectory, bytes]:
    from calibration.plane import TagBoard

    source = open_source(path)
    if "tags.json" not in source.attachments:
        raise InputError(f"{path} does not say where its tags are", expected="an attachment tags.json")
    plane = plane_of(source, TagBoard.from_json(json.loads(source.attachments["tags.json"])))
    tracked = track(source, plane, names, design.morphology.positions[marks], seen)
    (_, first), *_ = islice(source, 1)
    return tracked, overlay(first, plane, tracked)


def motions_without_camera(design: Design, schedule: ActuationSchedule, rig: Rig) -> tuple[Motion, Motion]:
    """The evolved motion of the design's marks, and the one predicted for exactly this schedule."""
    marks = design.marks
    names = tuple(f"m{i + 1}" for i in range(len(marks)))
    robot = build(design.morphology, ballast=design.ballast / 2)  # of one plane
    span = (schedule.start_of_cycles, schedule.period_s, schedule.cycles)
    predicted = Trajectory(names, *_predicted(robot, schedule, rig, marks))
    return _evolved(design, marks, names, robot), Motion(predicted, *span, robot.body_length)


def _evolved(design: Design, marks: np.ndarray, names: tuple[str, ...], robot: BuiltRobot) -> Motion:
    """The closed-loop rollout: its last five whole cycles of the pattern generators."""
    (rollout,) = simulate([design.morphology], [design.controller], design.scene)
    if rollout.status != FINE:
        raise EldirError(f"the design's rollout blew up at step {rollout.status}", remedy="choose another")
    times = np.arange(len(rollout.positions)) * design.scene.dt
    period = 2 * np.pi / design.scene.omega
    cycles = min(CYCLES, int(times[-1] / period))
    # In simulation the ground lies at another height and the body at another place than on the table.
    placed = rollout.positions[:, marks] - rollout.positions[0].min(axis=0)
    return Motion(
        Trajectory(names, times, placed),
        float(times[-1] - cycles * period),
        period,
        cycles,
        design.morphology.body_length,
        robot.parameters.scale,
    )


def _predicted(
    robot: BuiltRobot, schedule: ActuationSchedule, rig: Rig, marks: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Times and positions of the marks of the nominal robot under exactly this schedule."""
    springs = rig.spring_parameters()
    channels, states = schedule.sampled(_INTERVAL)
    motor_of = {c.channel: c.spring for c in rig.channels}
    motors = int(robot.active.sum())
    # Both faces heat alike in the model; a plane's motor is on while either of its channels is.
    on = np.zeros((len(states), motors), bool)
    for column, channel in enumerate(channels):
        on[:, motor_of[channel]] |= states[:, column]
    lengths = heat(on, _INTERVAL, springs, SpringState.cold(motors, springs)).length
    table = np.concatenate([np.full((1, motors), springs.cold_length), lengths])
    (motion,) = drive([robot], [table], _INTERVAL, free=(springs.cold_length, springs.hot_length))
    if motion.status != FINE:
        raise EldirError("the predicted motion blew up", remedy="choose another design")
    return motion.times, motion.positions[:, marks]


def _remarks(schedule: ActuationSchedule) -> tuple[str, ...]:
    walks = schedule.predicted.get("displacement", {})
    walk = walks.get(schedule.predicted.get("method"), {})
    mean = walk.get("mean")
    if mean is None or mean >= _POOR_WALK:
        return ()
    return (
        f"The ensemble of builds predicts {mean:+.2f} body lengths per five cycles, less than {_POOR_WALK}: "
        "about one random two-motor design in a hundred walks half a body length; a larger population, "
        "or more generations, gives the build filter more to choose from.",
    )


def _attached(log: RunLog, name: str, read: Callable[[bytes], T]) -> T:
    if name not in log.attachments:
        raise InputError(
            f"{log.path} has no {name}",
            expected="a log of `eldir rig drive` with the design, schedule and rig attached",
            found=", ".join(log.attachments) or "no attachments",
        )
    try:
        return read(log.attachments[name])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{name} in {log.path} is damaged", found=str(error).splitlines()[0]) from None
