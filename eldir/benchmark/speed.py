"""`eldir benchmark speed`: robots an hour, and what the parts of a learning iteration cost.

One thread is timed by its processor time, several by the clock on the wall. An iteration is forward, backward
and update over 1000 states; learning's last forward pass is not counted.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from eldir.benchmark.measurement import POPULATIONS, limit_threads, ratio, time_in_turns
from eldir.benchmark.skips import with_motors
from eldir.benchmark.tables import text_table
from eldir.defaults import ITERATIONS
from eldir.engine.batch import BatchConfig, prepare
from eldir.morphology import Morphology
from eldir.scene import Scene
from eldir.terrain import Terrain
from eldir.training.configuration import TrainingConfig
from eldir.training.loop import initial_controllers

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Say = Callable[[str], None]
_ITERATIONS = 5
_MEMORY = """
import json, resource, sys
from eldir.benchmark.measurement import big
from eldir.learning import learn
from eldir.scene import Scene

def peak():
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 3)

learn(big(1), Scene(), 1)
begun = peak()
bodies = big(int(sys.argv[1]), seed=2)
bred = peak()
learn(bodies, Scene().replace(steps=10), 1)
print(json.dumps({"robots": len(bodies), "engine_gb": begun, "bodies_gb": bred, "peak_gb": peak()}))
"""
_FIRST_USE = """
import json, time
began = time.process_time()
from eldir.benchmark.measurement import small
from eldir.learning import learn
from eldir.scene import Scene
bodies, scene = small(1), Scene().replace(steps=2)
from eldir.engine.runtime import start
start()
started = time.process_time()
learn(bodies, scene, 1)
print(json.dumps({"start_s": round(started - began, 2), "kernel_s": round(time.process_time() - started, 2)}))
"""


def measure(quick: bool, say: Say) -> dict[str, Any]:
    """Measure all figures; `say` is called with a line before each."""
    robots, turns = (12, 5) if quick else (24, 15)
    values: dict[str, Any] = {"steps": Scene().steps, "iterations": _ITERATIONS, "turns": turns}
    for part, (name, population) in enumerate(POPULATIONS.items(), 1):
        say(f"{part} of 5: {name} robots on one thread")
        values[name] = _throughput(population(robots if name == "big" else 2 * robots), turns)
    say("3 of 5: several threads")
    values["scaling"] = _scaling(POPULATIONS["big"](2 * robots), turns)
    say("4 of 5: memory of many robots")
    values["memory"] = memory(1000 if quick else 10_000)
    say("5 of 5: first use, with an empty cache of compiled kernels and with a full one")
    values["first_use"] = first_use()
    return values


_TASKS = {
    "forward": "forward pass alone",
    "open loop": "without sensing",
    "passive": "without motors, forward alone",
    "rugged": "on rugged ground",
    "float64": "in float64",
}
"""What is timed relative to a whole iteration, in words."""


def describe(values: dict[str, Any]) -> str:
    """Tables, and what they mean for a run."""
    kinds = [values[kind] for kind in POPULATIONS]
    shares = [kind["share"] | kind["ratio"] for kind in kinds]
    rows = [
        ["springs of a robot", *(f"{kind['springs']:.0f}" for kind in kinds)],
        ["robot-iterations [1/s]", *(f"{kind['iterations_per_s']:.0f}" for kind in kinds)],
        ["one step of one robot [us]", *(f"{kind['us_per_step']:.2f}" for kind in kinds)],
    ]
    rows += [
        [f"{task} [% of an iteration]", *(f"{share[key]:.0%}".rstrip("%") for share in shares)]
        for key, task in _TASKS.items()
    ]
    table = text_table(["on one thread", *(f"{kind} robots" for kind in POPULATIONS)], rows)
    counts, memory, first = values["scaling"], values["memory"], values["first_use"]
    threads = text_table(
        ["threads", *counts], [["speed, one thread = 1", *(f"{v:.2f}" for v in counts.values())]]
    )
    best = max(counts, key=lambda n: counts[n])
    seconds = 1000 * ITERATIONS / values["big"]["iterations_per_s"]
    learned = f"1000 big robots learn {ITERATIONS} iterations in {seconds:.0f} s on one thread"
    verdict = [
        learned + "; more threads gain nothing here."
        if best == "1"
        else f"{learned}, in {seconds / counts[best]:.0f} s on {best} threads.",
        f"{memory['robots']} robots that learn need {memory['peak_gb']:.2g} GB of memory.",
        f"The first start of a new version compiles for {first['compiled']['kernel_s']:.1f} s; later starts "
        f"are ready after {sum(first['cached'].values()):.1f} s (processor time).",
    ]
    return "\n".join([table, "", threads, "", *verdict])


def _throughput(bodies: list[Morphology], turns: int) -> dict[str, Any]:
    """Throughput on one thread: iterations a second, and the time of simpler scenes relative to an
    iteration."""
    paper, rugged = Scene(), Scene().replace(terrain=Terrain.rugged(np.random.default_rng(1)))
    deaf = paper.replace(sensing="none")
    passive = [with_motors(body, False) for body in bodies]
    with limit_threads(1):
        variants = {
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
    seconds = time_in_turns(variants, turns, time.process_time)
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
    variants = {}
    for n in (1, 2, 4):
        with limit_threads(n):
            variants[str(n)] = _learning(bodies, Scene())
    seconds = time_in_turns(variants, turns)
    return {n: round(ratio(seconds, "1", n), 3) for n in variants}


def _learning(bodies: list[Morphology], scene: Scene) -> Callable[[], object]:
    brains = initial_controllers(bodies, scene, 0)
    return prepare(
        bodies,
        brains,
        scene,
        config=BatchConfig(
            iterations=_ITERATIONS, backward=True, update_length=TrainingConfig().update_length
        ),
    )


def _forward(bodies: list[Morphology], scene: Scene) -> Callable[[], object]:
    brains = initial_controllers(bodies, scene, 0)
    return prepare(bodies, brains, scene)


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


def memory(robots: int) -> dict[str, float]:
    """Peak memory [GB] with the engine started, with random bodies beside it, and after they learned."""
    return _ask(_MEMORY, [str(robots)], {})


def first_use() -> dict[str, dict[str, float]]:
    """Processor seconds until the engine has started, and until the kernel has run: compiled, and later.

    Without NumPy's own threads: these only wait here, and their waiting would count."""
    with tempfile.TemporaryDirectory(prefix="eldir-") as cache:
        changes = {f"{c}_OFFLINE_CACHE_FILE_PATH": cache for c in ("TI", "QD")} | {"ELDIR_THREADS": "1"}
        changes |= {"OPENBLAS_NUM_THREADS": "1"}
        return {name: _ask(_FIRST_USE, [], changes) for name in ("compiled", "cached")}


def _ask(code: str, arguments: list[str], changes: dict[str, str]) -> dict[str, float]:
    ran = subprocess.run(
        [sys.executable, "-c", code, *arguments], check=True, stdout=subprocess.PIPE, env=os.environ | changes
    )
    values: dict[str, float] = json.loads(ran.stdout)
    return values
