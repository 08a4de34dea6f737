"""The printed robot's walk in the engine's built scene and in MuJoCo: the same heating, unequal physics."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from eldir.benchmark.built import BenchmarkRobot, walkers
from eldir.benchmark.measurement import limit_threads, time_in_turns
from eldir.built.gait import free_lengths
from eldir.built.robot import build
from eldir.built.walking import displacements
from eldir.core.records import FloatArray
from eldir.errors import EldirError
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir_cad.kit import PRINTER
from eldir_cad.kit.printer import load_printer
from eldir_cad.kit.specification import load_specification
from eldir_cad.multibody.model import Numerics, build_multibody
from eldir_calibration.transfer.mujoco_walks import FINE_NUMERICS, measure_walk

_STEPS = {"MuJoCo, 0.33 ms (rig)": Numerics(), "MuJoCo, 0.1 ms (transfer)": FINE_NUMERICS}
_CYCLES = 1


def against_mujoco(robots: int, turns: int) -> dict[str, Any]:
    """One thread, processor time. Joints, strips and contacts are modelled differently, so walks differ, and
    none is the truth of the other. The walks of all programs are told beside the times."""
    chosen = walkers()[:robots]
    seconds: dict[str, FloatArray] = {}
    walks: dict[str, list[float]] = {}
    with limit_threads(1):
        for robot in chosen:
            walked: dict[str, float] = {}
            ways = {name: partial(_store, walked, name, walk) for name, walk in _ways(robot).items()}
            for name, spent in time_in_turns(ways, turns, time.process_time).items():
                seconds[name] = seconds.get(name, np.zeros(turns)) + spent
                walks.setdefault(name, []).append(walked[name])
            if not np.isfinite(list(walked.values())).all():
                raise EldirError(
                    "a robot falls", expected="robots that walk in all programs", found=str(walked)
                )
    base = "engine, hubs"
    return {
        "base": base,
        "threads": 1,
        "clock": "processor time",
        "robots": len(chosen),
        "cycles": _CYCLES,
        "programs": {
            name: {
                "ms_per_walk": round(float(np.median(spent)) / len(chosen) * 1e3, 3),
                "times_the_base": round(float(np.median(spent / seconds[base])), 4),
                "from_to": [round(float(q), 4) for q in np.quantile(spent / seconds[base], [0, 1])],
                "walks": [round(walk, 4) for walk in walks[name]],
                "seconds": [round(float(s), 6) for s in spent],
            }
            for name, spent in seconds.items()
        },
    }


def _store(walked: dict[str, float], name: str, walk: Callable[[], float]) -> None:
    walked[name] = walk()


def _ways(robot: BenchmarkRobot) -> dict[str, Callable[[], float]]:
    """One walk [body lengths per five cycles] of the robot without deviations."""
    springs = SpringParameters()
    table = free_lengths(robot.gait, springs, _CYCLES)
    free = springs.cold_length, springs.hot_length
    printed = BuiltParameters()
    pins, hubs = (build(robot.body, RobotParameters(p)) for p in (printed, printed.with_hubs()))
    model = build_multibody(robot.body, load_specification(), load_printer(PRINTER))

    def in_the_engine(built: Any) -> float:
        return float(displacements([built], [table], _CYCLES, free)[0])

    def in_mujoco(numerics: Numerics) -> float:
        finer = replace(model, numerics=numerics)
        return measure_walk(finer, robot.body, table, _CYCLES, springs).displacement

    return {
        "engine, hubs": partial(in_the_engine, hubs),
        "engine, pins": partial(in_the_engine, pins),
        **{name: partial(in_mujoco, numerics) for name, numerics in _STEPS.items()},
    }
