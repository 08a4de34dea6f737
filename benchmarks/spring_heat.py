"""`python -m benchmarks.spring_heat DESIGN... --out FILE`: heat of far rigs, believed and measured.

Decision 79. Each design stands on virtual rigs with `parameter_spread: large`. How hot do the springs get in
the first gait of `eldir adapt`, and what does its belief say after one film? MuJoCo moves the robot; markers
have the camera's noise. And how far does the robot walk, in the engine, once the current, the air and the
springs are measured, with the highest current that the limits then allow? A rig is a line in FILE; those in
it are not computed again.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.headroom import Search, make_gait
from benchmarks.hidden_robot import HiddenRobot, Rows
from eldir.built.gait import SETTLE, Gait, heat_faces
from eldir.built.gait_search import find_gait
from eldir.built.heat import heat
from eldir.built.robot import build
from eldir.built.screening import PHASES
from eldir.core.records import FloatArray
from eldir.trajectory import Trajectory
from eldir_calibration.adaptation.films import nominal_robot
from eldir_calibration.adaptation.heat import peak_temperatures, robots_of
from eldir_calibration.dynamics.belief import believe
from eldir_calibration.dynamics.recording import INTERVAL, FilmedBody, Recording, find_fall
from eldir_hardware.planning.plan import heating_limits
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.sections import calibration_entry
from eldir_hardware.safety.margins import SUPPLY_STEP

_TIMINGS = (30.0, 6.0), (40.0, 6.0), (30.0, 4.0)  # periods and pulses that are tried [s]
_CURRENT = {"current": 0.02}
_AIR = {"ambient_min_c": 19.0, "ambient_max_c": 25.0}
_CONSTANTS = "convection_fan", "heat_capacity", "latent_heat"  # of the springs, that are measured
_NOISE = 0.15e-3  # of the camera [m]
_FRAME = 0.1  # [s]
_CYCLES = 2


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.spring_heat", description=__doc__)
    parser.add_argument("designs", nargs="+", type=Path, metavar="DESIGN")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="JSON lines, a rig in each")
    parser.add_argument("--seeds", nargs="+", type=int, default=[14, 15], help="of the rigs")
    given = parser.parse_args(arguments)
    rows = Rows(given.out)
    print(
        "| design | rig | hottest springs: true, believed [C] | walk as it is | current measured "
        "| air too | springs too |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for design_file, seed in product((file.resolve() for file in given.designs), given.seeds):
        row = rows.find(design_file, seed)
        if row is None:
            place = Search(design_file, seed, given.out.parent / f"{design_file.stem}-{seed}")
            row = {"design": str(design_file), "seed": seed} | _peaks(place) | _walks(place)
            rows.add(row)
        print(_describe(row), flush=True)


def _peaks(place: Search) -> dict[str, Any]:
    """True temperature of the hottest motor's springs, and that of the members of a belief after a film."""
    design, robot = place.design, place.robot
    gait = find_gait(design, heating_limits(place.rig), samples=2).gait
    recording = _film(robot, gait, place.seed)
    faces = np.repeat(np.arange(design.morphology.motors), 2)
    springs = heat(recording.contact_shares[:, faces], INTERVAL, robot.springs).temperature.max(axis=0)
    found: dict[str, Any] = {"true_c": float(springs.reshape(-1, 2).mean(axis=1).max())}
    fall = find_fall(build(design.morphology).positions[design.marks], recording.tracked)
    if fall is not None:
        return found | {"fall_s": fall}
    body = FilmedBody(design.morphology, design.marks, design.ballast / 2)
    belief = believe(body, [recording], nominal_robot(place.rig))
    members = robots_of(belief, place.rig.spring_parameters().current_limit)
    peaks = peak_temperatures(body.morphology, members, recording.contact_shares)
    return found | {"believed_c": float(peaks.mean()), "deviation_c": float(peaks.std())}


def _film(robot: HiddenRobot, gait: Gait, seed: int) -> Recording:
    from eldir_hardware.virtual.mujoco_body import MujocoMotion

    body, marks = robot.design.morphology, robot.design.marks
    table = heat_faces(gait, robot.springs, _CYCLES, body.motor_hubs)
    lengths = table.lengths.reshape(-1, body.motors, 2).mean(axis=2)
    motion = MujocoMotion(robot.model, (robot.springs[0].cold_length, robot.springs[0].hot_length))
    seen, every = [motion.positions[marks]], round(_FRAME / table.interval)
    for row in range(0, len(lengths) - every, every):
        motion.follow(lengths[row : row + every + 1], table.interval)
        seen.append(motion.positions[marks])
    x: FloatArray = np.array(seen)
    x += _NOISE * np.random.default_rng([seed, 5]).standard_normal(x.shape)
    times = _FRAME * np.arange(len(x))
    starts = INTERVAL * np.arange(round(times[-1] / INTERVAL))
    names = tuple(f"m{i + 1}" for i in range(len(marks)))
    on = gait.is_heating(starts - SETTLE + 1e-9).astype(float)
    return Recording(Trajectory(names, times, x), on, SETTLE + gait.period, gait.period, _CYCLES)


def _walks(place: Search) -> dict[str, Any]:
    """The best walk of all phases in the engine, and the current limit: as the rig is, and with what is
    measured."""
    rig, robot = place.rig, place.robot
    constants = {n: float(np.mean([getattr(s, n) for s in robot.springs])) for n in _CONSTANTS}
    springs = rig.springs.model_copy(update=constants | {"calibration": calibration_entry(constants)})
    current = rig.model_copy(update={"tolerances": rig.tolerances.model_copy(update=_CURRENT)})
    air = rig.model_copy(update={"tolerances": rig.tolerances.model_copy(update=_CURRENT | _AIR)})
    measured = {"current": current, "air": air, "springs": air.model_copy(update={"springs": springs})}
    found: dict[str, Any] = {"as_it_is": (_best_walk(place, robot, _TIMINGS), rig.supply.current_limit_a)}
    for name, other in measured.items():
        limits = [_highest_current(other, *timing) for timing in _TIMINGS]
        mean = float(np.mean([s.current_limit for s in robot.springs]))
        walks = [
            _best_walk(place, replace(robot, current=limit / mean), [timing])
            for limit, timing in zip(limits, _TIMINGS, strict=True)
        ]
        found[name] = max(zip(walks, limits, strict=True))
    return found


def _highest_current(rig: Rig, period: float, pulse: float) -> float:
    """With which the rig allows such pulses, in steps of a supply [A]; 0 if with none."""
    gait = make_gait(period, 0.0, [pulse])

    def allows(current: float) -> bool:
        supply = rig.supply.model_copy(update={"current_limit_a": current})
        return heating_limits(rig.model_copy(update={"supply": supply})).allowed(gait)

    steps = (round(SUPPLY_STEP * k, 2) for k in range(140, 20, -1))
    return next((current for current in steps if allows(current)), 0.0)


def _best_walk(place: Search, robot: HiddenRobot, timings: Sequence[tuple[float, float]]) -> float:
    motors = place.design.morphology.motors
    phases = range(PHASES if motors > 1 else 1)
    gaits = [make_gait(period, k / PHASES, [pulse] * motors) for period, pulse in timings for k in phases]
    return float(np.maximum(robot.engine_walks(gaits), -9.0).max())


def _describe(row: dict[str, Any]) -> str:
    believed = (
        f"falls at {row['fall_s']:.0f} s"
        if "fall_s" in row
        else f"{row['believed_c']:.0f} +- {row['deviation_c']:.0f}"
    )
    walks = [
        ("falls" if row[name][0] < -8 else f"{row[name][0]:+.2f}") + f" ({row[name][1]:.2f} A)"
        for name in ("as_it_is", "current", "air", "springs")
    ]
    return f"| {row['design']} | {row['seed']} | {row['true_c']:.0f}, {believed} | {' | '.join(walks)} |"


if __name__ == "__main__":
    main()
