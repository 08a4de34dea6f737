"""Measuring how fast robots learn on a device: kernels, batch sizes, and a whole generation of learning."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from eldir.benchmark.measurement import POPULATIONS
from eldir.benchmark.tables import text_table
from eldir.core.kernels import compiler_name
from eldir.defaults import ITERATIONS
from eldir.engine.batch import device_task
from eldir.engine.device.process import chosen_device, compute, device_label
from eldir.engine.device.records import DeviceTask
from eldir.engine.pack import pack
from eldir.learning import initial_controllers
from eldir.morphology import Morphology
from eldir.physics import resolve_physics
from eldir.scene import Scene
from eldir.training.configuration import TrainingConfig

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BODIES = 200  # more robots are these again
_TURNS = 3


def measure(quick: bool, say: Callable[[str], None]) -> dict[str, Any]:
    """Robot-iterations a second over numbers of robots, and a generation of 10 000. Raises `EldirError` where
    there is no device."""
    started = time.perf_counter()
    values: dict[str, Any] = {"device": chosen_device(), "name": device_label(), "compiler": compiler_name()}
    values["start_s"] = round(time.perf_counter() - started, 2)
    say(f"{values['name']}, {values['compiler']}")
    counts = (128, 512) if quick else (32, 128, 512, 1024, 2048, 4096)
    for kind, population in POPULATIONS.items():
        bodies, found = population(min(counts[-1], _BODIES)), []
        for count in counts:
            found.append(_throughput(_task([bodies[i % len(bodies)] for i in range(count)], 2)))
            say(f"{kind} robots: {count} of {counts[-1]}")
        values[kind] = {"robots": list(counts), "iterations_per_s": found}
    robots = 512 if quick else 10_000
    say(f"a generation of {robots} robots")
    bodies = POPULATIONS["big"](_BODIES)
    mean_loss, packed, seconds = _generation([bodies[i % len(bodies)] for i in range(robots)])
    values["generation"] = {
        "robots": robots, "iterations": ITERATIONS, "seconds": seconds, "packing_s": packed,
        "mean_loss_m": mean_loss,
    }  # fmt: skip
    return values


_FULL = 0.9
"""Share of the greatest speed at which a device counts as fully used."""


def describe(values: dict[str, Any]) -> str:
    """A table, how many robots the device needs, and a generation's time."""
    speeds = [values[kind]["iterations_per_s"] for kind in POPULATIONS]
    counts = values["big"]["robots"]
    table = text_table(
        ["robots at a time", *(f"{kind} robots [iterations/s]" for kind in POPULATIONS)],
        [
            [str(count), *(f"{speed:.0f}" for speed in row)]
            for count, *row in zip(counts, *speeds, strict=True)
        ],
    )
    big = values["big"]["iterations_per_s"]
    enough = next(n for n, speed in zip(counts, big, strict=True) if speed >= _FULL * max(big))
    learned = values["generation"]
    verdict = [
        f"{values['name']} ({values['device']}, {values['compiler']}) is ready after {values['start_s']:.1f} "
        "s.",
        f"It is fully used from {enough} big robots at a time.",
        f"A generation of {learned['robots']} robots learns {learned['iterations']} iterations in "
        f"{learned['seconds']:.2f} s, after {learned['packing_s']:.2f} s of packing.",
    ]
    if learned["mean_loss_m"] is None:
        verdict.append("At least one robot of it diverged.")
    return "\n".join([table, "", *verdict])


def _throughput(task: DeviceTask) -> float:
    """Robot-iterations a second, without packing and transfers: the median of a few differences between
    two numbers of updates."""
    more = task._replace(settings=task.settings._replace(iterations=3 * task.settings.iterations))
    differences = []
    for _ in range(_TURNS + 1):
        less_s, more_s = (_seconds(one) for one in (task, more))
        differences.append(more_s - less_s)
    computed = len(task.sizes) * (more.settings.iterations - task.settings.iterations)
    return round(float(computed / np.median(differences[1:])), 1)


def _seconds(task: DeviceTask) -> float:
    begun = time.perf_counter()
    compute(task)
    return time.perf_counter() - begun


def _generation(bodies: list[Morphology]) -> tuple[float | None, float, float]:
    """Mean last loss [m], None if a robot diverged; seconds of packing, and of learning and transfers."""
    begun = time.perf_counter()
    task = _task(bodies, ITERATIONS)
    packed = time.perf_counter()
    losses = compute(task).losses
    ended = time.perf_counter()
    last = float(losses[:, -1].mean())
    return last if np.isfinite(last) else None, round(packed - begun, 3), round(ended - packed, 3)


def _task(bodies: list[Morphology], iterations: int) -> DeviceTask:
    scene = Scene.preset("paper")
    batch = pack(bodies, initial_controllers(bodies, scene, 0), scene, resolve_physics(bodies, scene, None))
    return device_task(batch, scene, iterations, TrainingConfig().update_length)


def plot(values: dict[str, Any]) -> Figure:
    """Speed over the number of robots that learn at the same time."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 3.6), layout="constrained")
    axes = figure.subplots()
    for kind in POPULATIONS:
        axes.plot(values[kind]["robots"], values[kind]["iterations_per_s"], "o-", label=f"{kind} robots")
    counts = values["big"]["robots"]
    axes.set(xscale="log", xlabel="robots", ylabel="robot-iterations a second", ylim=(0, None))
    axes.minorticks_off()
    axes.set_xticks(counts, [str(n) for n in counts])
    axes.set_title(f"{values['name']}, {values['compiler']}")
    axes.legend()
    return figure
