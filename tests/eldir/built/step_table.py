"""`python -m tests.eldir.built.step_table`: time step, error and run time of the built scene, the table of
docs/reference/built.md."""

from __future__ import annotations

import time

import numpy as np

from eldir.built.gait import Gait, free_lengths
from eldir.built.motion import drive
from eldir.built.robot import PrintedRobot, build
from eldir.built.stability import stable_step_in_any_pose
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from tests.calibration.dynamics.hidden_rigs import PHASE, walker
from tests.eldir.built.braced_robots import COLD, HOT

CYCLES, LANES, SCHEDULE = 2, 8, 123.0
SHARES = (1 / 8, 1 / 4, 1 / 2, 0.95)


def timed(robot: PrintedRobot, count: int, step: float) -> tuple[np.ndarray, float, float]:
    """Positions in the counted cycles, walk [body lengths per five cycles], and processor time of each robot
    for a schedule [s]."""
    table = free_lengths(Gait(20.0, np.array([0.0, PHASE]), np.array([0.3, 0.3])), cycles=CYCLES)
    begun = time.process_time()
    motion = drive([robot] * count, [table.lengths] * count, table.interval, step=step, free=(COLD, HOT))[0]
    spent = (time.process_time() - begun) / count / motion.times[-1] * SCHEDULE
    counted = motion.positions[table.first_cycle :]
    walked = counted[-1, :, 0].mean() - counted[0, :, 0].mean()
    return counted, float(walked / robot.body_length * 5 / CYCLES), spent


def main() -> None:
    """Print one row for each kind of joints and step."""
    body = walker().morphology
    feet = np.exp(0.1 * np.random.default_rng(3).standard_normal(len(body.positions)))
    for joints in (BuiltParameters(), BuiltParameters().with_hubs()):
        robot = build(body, RobotParameters(joints, feet=feet))
        timed(robot, 1, 0.95 * stable_step_in_any_pose(robot))  # compiles
        shapes = None
        for share in SHARES:
            step = share * stable_step_in_any_pose(robot)
            counted, walked, alone = timed(robot, 1, step)
            side_by_side = timed(robot, LANES, step)[2]
            own = counted - counted.mean(axis=1, keepdims=True)
            shapes = own if shapes is None else shapes
            print(
                f"| {robot.joints} | {1e6 * step:.0f} | {walked:.3f} | "
                f"{1e3 * np.sqrt(np.mean((own - shapes) ** 2)):.3f} | "
                f"{1e3 * np.abs(own - shapes).max():.2f} | "
                f"{alone:.1f} | {side_by_side:.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
