"""`eldir benchmark speed`: robots an hour, and what the parts of a learning iteration cost.

One thread is timed by its processor time, several by the clock on the wall. An iteration is forward, backward
and update over 1000 states; learning's last forward pass is not counted.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from eldir.benchmark import cost
from eldir.benchmark.populations import POPULATIONS
from eldir.benchmark.skips import with_motors
from eldir.benchmark.turns import limited_threads, ratio, take_turns
from eldir.engine.batch import prepare
from eldir.engine.shortcuts import ALL
from eldir.morphology import Morphology
from eldir.scene import Scene
from eldir.terrain import Terrain
from eldir.training.configuration import Training
from eldir.training.initial import initial_controllers

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Say = Callable[[str], None]
_ITERATIONS = 5


def measure(quick: bool, say: Say) -> dict[str, Any]:
    """Measure all figures; `say` is called with a line after each."""
    robots, turns = (12, 5) if quick else (24, 15)
    values: dict[str, Any] = {"steps": Scene().steps, "iterations": _ITERATIONS, "turns": turns}
    for name, population in POPULATIONS.items():
        values[name] = _throughput(population(robots if name == "big" else 2 * robots), turns)
        say(f"{name}: {values[name]}")
    values["scaling"] = _scaling(POPULATIONS["big"](2 * robots), turns)
    say(f"scaling over threads: {values['scaling']}")
    values["memory"] = cost.memory(1000 if quick else 10_000)
    say(f"memory: {values['memory']}")
    values["first_use"] = cost.first_use()
    say(f"first use: {values['first_use']}")
    return values


def _throughput(bodies: list[Morphology], turns: int) -> dict[str, Any]:
    """Throughput on one thread: iterations a second, and the time of simpler scenes relative to an
    iteration."""
    paper, rugged = Scene(), Scene().replace(terrain=Terrain.rugged(np.random.default_rng(1)))
    deaf = paper.replace(sensing="none")
    passive = [with_motors(body, False) for body in bodies]
    with limited_threads(1):
        ways = {
            "whole": _learning(bodies, paper),
            "forward": _forward(bodies, paper),
            "open loop": _learning(bodies, deaf),
            "open loop forward": _forward(bodies, deaf),
            "passive": _forward(passive, paper),
            "rugged": _learning(bodies, rugged),
            "rugged forward": _forward(bodies, rugged),
            "float64": _learning(bodies, paper.replace(precision="f64")),
            "float64 forward": _forward(bodies, paper.replace(precision="f64")),
        }
    seconds = take_turns(ways, turns, time.process_time)
    for learning, forward in (
        ("whole", "forward"),
        ("open loop", "open loop forward"),
        ("rugged", "rugged forward"),
        ("float64", "float64 forward"),
    ):
        seconds[learning] = (seconds[learning] - seconds[forward]) / _ITERATIONS
    each = seconds["whole"] / len(bodies)
    return {
        "springs": float(np.mean([len(body.springs) for body in bodies])),
        "iterations_per_s": round(float(1 / np.median(each)), 1),
        "us_per_step": round(float(np.median(each)) / (paper.steps + 1) * 1e6, 4),
        "share": {key: round(ratio(seconds, key, "whole"), 3) for key in ("forward", "open loop", "passive")},
        "ratio": {key: round(ratio(seconds, key, "whole"), 3) for key in ("rugged", "float64")},
    }


def _scaling(bodies: list[Morphology], turns: int) -> dict[str, float]:
    """Speed with several threads, relative to one thread."""
    ways = {}
    for n in (1, 2, 4):
        with limited_threads(n):
            ways[str(n)] = _learning(bodies, Scene())
    seconds = take_turns(ways, turns)
    return {n: round(ratio(seconds, "1", n), 3) for n in ways}


def _learning(bodies: list[Morphology], scene: Scene) -> Callable[[], object]:
    brains = initial_controllers(bodies, scene, 0)
    return prepare(
        bodies,
        brains,
        scene,
        iterations=_ITERATIONS,
        backward=True,
        record=False,
        shortcuts=ALL,
        update_length=Training().update_length,
    )


def _forward(bodies: list[Morphology], scene: Scene) -> Callable[[], object]:
    brains = initial_controllers(bodies, scene, 0)
    return prepare(bodies, brains, scene, iterations=0, backward=False, record=False, shortcuts=ALL)


def plot(values: dict[str, Any]) -> Figure:
    """Times relative to an iteration, and the speed with several threads beside the ideal."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.6), layout="constrained")
    bars, lines = figure.subplots(1, 2)
    names = [*values["big"]["share"], *values["big"]["ratio"]]
    for k, kind in enumerate(POPULATIONS):
        heights = [(values[kind]["share"] | values[kind]["ratio"])[name] for name in names]
        label = f"{values[kind]['springs']:.0f} springs, {values[kind]['iterations_per_s']:.0f} iterations/s"
        bars.bar(np.arange(len(names)) + 0.4 * k - 0.2, heights, 0.4, label=label)
    bars.set_xticks(range(len(names)), names)
    bars.axhline(1, color="grey", lw=0.8)
    bars.set_ylabel("time, relative to an iteration")
    bars.legend()
    counts = [int(n) for n in values["scaling"]]
    lines.plot(counts, list(values["scaling"].values()), "o-")
    lines.plot(counts, counts, color="grey", lw=0.8)
    lines.set(xlabel="threads", ylabel="speed, relative to one thread", xticks=counts)
    return figure
