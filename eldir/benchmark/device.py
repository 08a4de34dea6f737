"""Measuring how fast robots learn on a device: kernels, batch sizes, and a whole generation of learning."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from eldir.benchmark.populations import POPULATIONS
from eldir.core.kernels import compiler_name
from eldir.engine.batch import prepare
from eldir.engine.device.process import chosen_device, device_text
from eldir.engine.shortcuts import ALL
from eldir.learning import initial_controllers
from eldir.morphology import Morphology
from eldir.scene import Scene
from eldir.training.configuration import Training
from eldir.training.defaults import ITERATIONS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BODIES = 600  # more robots are these again
_TURNS = 3


def measure(quick: bool, say: Callable[[str], None]) -> dict[str, Any]:
    """Robots a second that are taught `ITERATIONS` updates. Raises `EldirError` where there is no device."""
    started = time.perf_counter()
    values: dict[str, Any] = {"device": chosen_device(), "name": device_text(), "compiler": compiler_name()}
    values["start_s"] = round(time.perf_counter() - started, 2)
    say(f"{values['name']}, {values['compiler']}")
    counts = (128, 512) if quick else (32, 128, 512, 2048, 8192)
    for kind, population in POPULATIONS.items():
        bodies, found = population(min(counts[-1], _BODIES)), []
        for count in counts:
            found.append(_throughput([bodies[i % len(bodies)] for i in range(count)], 2))
            say(f"{kind}, {count} robots: {found[-1]:.0f} robot-iterations a second")
        values[kind] = {"robots": list(counts), "iterations_per_s": found}
    robots = 512 if quick else 10_000
    bodies = POPULATIONS["big"](_BODIES)
    taught, packed, seconds = _generation([bodies[i % len(bodies)] for i in range(robots)])
    say(f"{robots} robots taught {ITERATIONS} updates in {seconds:.2f} s, packed before in {packed:.2f} s")
    values["generation"] = {
        "robots": robots, "iterations": ITERATIONS, "seconds": seconds, "packing_s": packed,
        "mean_loss_m": taught,
    }  # fmt: skip
    return values


def _throughput(bodies: list[Morphology], iterations: int) -> float:
    """Robot-iterations a second, without packing and transfers: the median of a few differences between
    two numbers of updates."""
    more, less = (_task(bodies, n) for n in (2 * iterations, iterations))
    differences = []
    for _ in range(_TURNS + 1):
        seconds = []
        for compute in (less, more):
            begun = time.perf_counter()
            compute()
            seconds.append(time.perf_counter() - begun)
        differences.append(seconds[1] - seconds[0])
    return round(float(len(bodies) * iterations / np.median(differences[1:])), 1)


def _generation(bodies: list[Morphology]) -> tuple[float, float, float]:
    """Mean last loss [m]; seconds of packing, and of learning with all transfers."""
    begun = time.perf_counter()
    compute = _task(bodies, ITERATIONS)
    packed = time.perf_counter()
    losses = compute().losses
    ended = time.perf_counter()
    return float(losses[:, -1].mean()), round(packed - begun, 3), round(ended - packed, 3)


def _task(bodies: list[Morphology], iterations: int) -> Callable[[], Any]:
    scene = Scene.preset("paper")
    return prepare(
        bodies, initial_controllers(bodies, scene, 0), scene, iterations=iterations, backward=True,
        record=False, shortcuts=ALL, update_length=Training().update_length,
    )  # fmt: skip


def plot(values: dict[str, Any]) -> Figure:
    """Speed over the number of robots that learn at the same time."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 3.6), layout="constrained")
    axes = figure.subplots()
    for kind in POPULATIONS:
        axes.plot(values[kind]["robots"], values[kind]["iterations_per_s"], "o-", label=f"{kind} robots")
    axes.set(xscale="log", yscale="log", xlabel="robots", ylabel="robot-iterations a second")
    axes.set_title(f"{values['name']}, {values['compiler']}")
    axes.legend()
    return figure
