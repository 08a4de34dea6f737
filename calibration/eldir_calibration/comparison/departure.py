"""Whether a filmed robot left its plane of motion, and by how much its walk is then uncertain."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from eldir.built.gait import CYCLES
from eldir.core.records import FloatArray, IntArray
from eldir.design import Design
from eldir.errors import InputError
from eldir.trajectory import Trajectory
from eldir_cad.kit.specification import load_specification
from eldir_calibration.dynamics.recording import find_fall
from eldir_calibration.report.comparison import Motion
from eldir_calibration.report.numbers import OutOfPlaneNumbers
from eldir_calibration.report.verdict import RobotLoss
from eldir_hardware.camera.plane import Plane
from eldir_hardware.vision.out_of_plane import Interval95, MarkerLoss, PlaneDeparture, PlaneObserver
from eldir_hardware.vision.pipeline import TrackingResult

_WINDOW_S = 2.0  # over which a robot's place and lean are estimated
_WINDOWS = 12  # over the cycles that count


@dataclass(frozen=True)
class Standing:
    """A filmed motion up to the loss of all markers, and what tells how the robot stands."""

    observer: PlaneObserver
    trajectory: Trajectory
    """Of the markers, up to their loss if there is one."""
    loss: MarkerLoss | None
    """When all markers vanished for good, such as in a fall; None where they did not."""


def observe_standing(found: TrackingResult, design: Design, plane: Plane, focal: float | None) -> Standing:
    """Cut a film where no marker is seen any more: their last places would count as a robot that stands
    still. `focal` [px]: of a calibrated lens."""
    observer = PlaneObserver(found.trajectory, found.sizes, marked_strips(design), plane, focal)
    path, loss = found.trajectory, observer.find_loss()
    if loss is None:
        return Standing(observer, path, None)
    until = path.times <= loss.last_seen_s
    standing = replace(
        path, times=path.times[until], positions=path.positions[until], bridged=path.bridged[until]
    )
    return Standing(observer, standing, loss)


def find_robot_loss(standing: Standing, rest: FloatArray | None) -> RobotLoss | None:
    """When a filmed robot fell or got out of sight, whichever came first; None where it did not. `rest`
    (K, 2) [m]: positions of its markers at rest; None: falls in the plane of motion are not looked for."""
    fall = None if rest is None else find_fall(rest, standing.trajectory)
    if fall is not None:
        return RobotLoss(fall, "fell")
    lost = standing.loss
    if lost is None:
        return None
    return RobotLoss(lost.last_seen_s, "fell sideways" if lost.fell else "lost")


def require_whole_cycle(loss: RobotLoss | None, first_cycle_end: float, name: str) -> None:
    """Raise `InputError` for a robot that was lost before the first cycle that counts had ended [s]."""
    if loss is not None and loss.time_s < first_cycle_end:
        raise InputError(
            f"{name}: the robot fell or got out of sight before the first cycle that counts had ended",
            code="film.lost",
            expected=f"a robot that stands as designed, and is seen, for {first_cycle_end:.0f} s",
            found=describe_robot_loss(loss),
            remedy="see on the film what happened; faces that heat differently make a robot fall sideways",
        )


def describe_robot_loss(loss: RobotLoss) -> str:
    """A phrase on how the robot was lost."""
    if loss.kind != "lost":
        return f"the robot {loss.phrase}"
    return f"no marker after {loss.time_s:.1f} s: it fell over, left the picture or was covered"


def describe_lost_cycles(loss: RobotLoss | None) -> str:
    """A sentence for a reader of the walk; empty where the robot stayed upright and in sight."""
    if loss is None:
        return ""
    how = describe_robot_loss(loss)
    return f"{how[0].upper()}{how[1:]}. Only cycles that ended before count."


def measure_departure(standing: Standing, motion: Motion) -> OutOfPlaneNumbers | None:
    """How the robot stood over the cycles that count; None where no strip joins two markers that were
    seen."""
    begin, end = motion.start, motion.start + motion.cycles * motion.period
    times = np.linspace(begin, end - _WINDOW_S, _WINDOWS)
    poses = [p for t in times.tolist() if (p := standing.observer.estimate(t, t + _WINDOW_S)) is not None]
    if not poses:
        return None
    last, half_width = poses[-1], 1e-3 * load_specification().outside
    errors = [pose.path_error(half_width, motion.body_length / 2) for pose in (poses[0], last)]
    return OutOfPlaneNumbers(
        _degrees(last.yaw),
        _degrees(_frequent_lean(poses)),
        (last.depth.low, last.depth.median, last.depth.high),
        math.hypot(*errors) / motion.body_length * CYCLES / motion.cycles,
        _is_certain(poses),
        None if standing.loss is None else standing.loss.last_seen_s,
        standing.loss is not None and standing.loss.fell,
    )


def marked_strips(design: Design) -> IntArray:
    """Pairs of markers, by their numbers from 0, that a strip joins, shape (P, 2)."""
    number = {mass: k for k, mass in enumerate(design.marks.tolist())}
    strips = design.morphology.springs[~design.morphology.active].tolist()
    pairs = [(number[a], number[b]) for a, b in strips if a in number and b in number]
    return np.array(pairs, int).reshape(-1, 2)


def describe_departure(found: OutOfPlaneNumbers | None) -> str:
    """One sentence for a reader of the walk; empty for a robot that stays in its plane as far as its markers
    tell."""
    if found is None or not found.certain:
        return ""
    depth = found.depth_share
    where = "behind" if depth[1] > 0 else "before"
    low, high = sorted(abs(v) for v in (depth[0], depth[2]))
    share = f"{abs(depth[1]):.1%} ({low:.1%} to {high:.1%}) of the camera's distance {where} it"
    if depth[0] * depth[2] <= 0:
        share = f"within {high:.1%} of the camera's distance of it"
    return (
        f"The robot left its plane of motion: at the end its markers were {share}, it had turned by "
        f"{_angle(found.yaw_deg)}, and leaned by {_angle(found.lean_deg)}. Its filmed walk is uncertain by "
        f"{found.walk_error:.2f} body lengths per five cycles for that."
    )


def _is_certain(poses: list[PlaneDeparture]) -> bool:
    """Whether the last two poses, or a quarter, show that the robot is out of its plane: one may be wrong."""
    certain = [pose.is_certain for pose in poses]
    return all(certain[-2:]) or 4 * sum(certain) >= len(certain)


def _frequent_lean(poses: list[PlaneDeparture]) -> Interval95:
    """The lean that a quarter of the poses reach, by their low ends and medians, and the largest high end: of
    twelve intervals one may well lie beside the truth."""
    columns = zip(*((p.lean.low, p.lean.median, p.lean.high) for p in poses), strict=True)
    low, median, high = (sorted(column, reverse=True) for column in columns)
    rank = (len(poses) + 3) // 4 - 1
    return Interval95(low[rank], median[rank], high[0])


def _degrees(interval: Interval95) -> tuple[float, float, float]:
    low, median, high = np.degrees([interval.low, interval.median, interval.high]).tolist()
    return low, median, high


def _angle(interval: tuple[float, float, float]) -> str:
    """Such as "at most 12 degrees"."""
    low, median, high = interval
    return f"{median:.0f} ({low:.0f} to {high:.0f}) degrees" if low > 0 else f"at most {high:.0f} degrees"
