"""The comparisons: each checks results against the engine in float64, then lets the programs take turns."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import by_hand, engine
from benchmarks.program import Program
from benchmarks.task import Task, make_task
from eldir.benchmark.turns import take_turns
from eldir.controller import Controller
from eldir.core.kernels import Precision
from eldir.core.records import FloatArray
from eldir.errors import EldirError
from eldir.scene import Scene

PRECISIONS: tuple[Precision, ...] = ("f32", "f64")
_SAME = {"losses": 1e-9, "gradients": 1e-6}
"""Greatest difference in float64: of losses [m], and of gradients relative to their length."""
_NEAR = {"losses": 1e-6, "gradients": 1e-2}
"""The same in float32 for the median robot: a few robots are chaotic, and make much of rounding."""


def against_c(kind: str, robots: int, turns: int, folder: Path) -> dict[str, Any]:
    """The engine and the C program, one thread each, processor time."""
    task = make_task(kind, robots, 5, Scene.preset("paper"))
    ways: dict[str, Callable[[], object]] = {}
    errors: dict[str, FloatArray] = {}
    for precision in PRECISIONS:
        program = by_hand.compile_program(folder, precision)
        found = [by_hand.gradient(program, task, i) for i in range(robots)]
        losses = np.array([loss for loss, _ in found])
        slopes = _slope_errors(task, [gradient for _, gradient in found])
        _require(f"C {precision}", losses, task, precision, slopes)
        ways[f"C {precision}"] = by_hand.learning(program, task)
        ways[f"engine {precision}"] = engine.learning(task, precision, 1)
        errors[f"C {precision}"] = np.abs(losses - task.losses)
        errors[f"engine {precision}"] = np.abs(engine.first_losses(task, precision) - task.losses)
    seconds = take_turns(ways, turns, time.process_time)
    return _told(task, seconds, errors, threads=1, clock="processor time", base="C")


def against_jax(kind: str, robots: int, turns: int, folder: Path) -> dict[str, Any]:
    """The engine and the scene in JAX, one thread each, processor time. Compiling is told and not counted."""
    task = make_task(kind, robots, 5, Scene.preset("paper"))
    task.save(folder / "task.npz")
    own = {f"engine {p}": engine.learning(task, p, 1) for p in PRECISIONS}
    errors = {f"engine {p}": np.abs(engine.first_losses(task, p) - task.losses) for p in PRECISIONS}
    script, compiled = Path(__file__).with_name("jax_program.py"), {}
    with ExitStack() as programs:
        others = {}
        for precision in PRECISIONS:
            name, slopes = f"JAX {precision}", folder / f"{precision}.npz"
            call: list[str | Path] = [sys.executable, script, folder / "task.npz", precision, slopes]
            others[name] = programs.enter_context(Program(call, folder / f"{precision}.txt"))
            began = time.perf_counter()
            _, losses = others[name].turn()  # compiles
            compiled[name] = round(time.perf_counter() - began, 1)
            _require(name, losses, task, precision, _slope_errors(task, task.saved_gradients(slopes)))
            errors[name] = np.abs(losses - task.losses)
        for way in own.values():
            way()
        taken: dict[str, list[float]] = {name: [] for name in (*others, *own)}
        for _ in range(turns):
            for name, program in others.items():
                taken[name].append(program.turn()[0][1])
            for name, way in own.items():
                spent = time.process_time()
                way()
                taken[name].append(time.process_time() - spent)
    seconds = {name: np.array(t) for name, t in taken.items()}
    told = _told(task, seconds, errors, threads=1, clock="processor time", base="JAX")
    return told | {"first_turn_s": compiled}


def _slope_errors(task: Task, found: Sequence[Controller]) -> FloatArray:
    """Error of each robot's gradient, relative to its length."""
    both = zip(found, task.gradients, strict=True)
    return np.array([np.linalg.norm(m.flat - e.flat) / np.linalg.norm(e.flat) for m, e in both])


def against_released(code: Path, kind: str, robots: int, turns: int, folder: Path) -> dict[str, Any]:
    """The engine and the paper's released code (branch main), all cores, by the clock.

    Its gradient is not compared: the released code differentiates tanh wrongly (docs/decisions/0003).
    """
    if not (code / "simulator" / "sim.py").exists():
        raise EldirError(
            "this is not the released code", expected="a folder with simulator/sim.py", found=str(code)
        )
    task = make_task(kind, robots, 3, Scene.preset("released-main"))
    task.save(folder / "task.npz")
    threads = len(os.sched_getaffinity(0))
    own = {f"engine {p}": engine.learning(task, p, threads) for p in PRECISIONS}
    errors = {f"engine {p}": np.abs(engine.first_losses(task, p) - task.losses) for p in PRECISIONS}
    script = Path(__file__).with_name("released_program.py")
    with Program([sys.executable, script, code, folder / "task.npz"], folder / "released.txt") as program:
        _, losses = program.turn()  # compiles
        _require("released", losses, task, "f64")
        errors["released f64"] = np.abs(losses - task.losses)
        for way in own.values():
            way()
        taken: dict[str, list[tuple[float, float]]] = {name: [] for name in ("released f64", *own)}
        for _ in range(turns):
            taken["released f64"].append(program.turn()[0])
            for name, way in own.items():
                began, spent = time.perf_counter(), time.process_time()
                way()
                taken[name].append((time.perf_counter() - began, time.process_time() - spent))
    seconds, processor = ({name: np.array(t)[:, c] for name, t in taken.items()} for c in (0, 1))
    told = _told(task, seconds, errors, threads=threads, clock="wall clock", base="released")
    for name, values in _told(task, processor, errors, base="released")["programs"].items():
        told["programs"][name]["processor_time"] = values
    return told


def _require(
    name: str, losses: FloatArray, task: Task, precision: Precision, slopes: FloatArray | None = None
) -> None:
    """Equal results before any time is taken."""
    for what, error in (("losses", np.abs(losses - task.losses)), ("gradients", slopes)):
        if error is None:
            continue
        found = float(np.max(error) if precision == "f64" else np.median(error))
        allowed = (_SAME if precision == "f64" else _NEAR)[what]
        if not found <= allowed:
            raise EldirError(
                f"{what} of {name} are not the engine's", expected=f"at most {allowed:g}", found=f"{found:g}"
            )


def _told(
    task: Task, seconds: Mapping[str, FloatArray], errors: Mapping[str, FloatArray], **settings: Any
) -> dict[str, Any]:
    """Settings, raw seconds, and for each program its speed, also relative to the base in the same precision,
    and its error."""
    work = len(task.bodies) * task.iterations
    relative = {
        name: values / seconds[_base(settings["base"], name, seconds)] for name, values in seconds.items()
    }
    return {
        **settings,
        "scene": task.scene.name,
        "robots": len(task.bodies),
        "springs": float(np.mean([len(body.springs) for body in task.bodies])),
        "iterations": task.iterations,
        "steps": task.scene.steps,
        "programs": {
            name: {
                "ms_per_robot_iteration": round(float(np.median(values)) / work * 1e3, 4),
                "times_the_base": round(float(np.median(relative[name])), 4),
                "from_to": [round(float(q), 4) for q in np.quantile(relative[name], [0, 1])],
                "loss_error_m": float(np.median(errors[name])),
                "seconds": [round(float(s), 6) for s in values],
            }
            for name, values in seconds.items()
        },
    }


def _base(base: str, program: str, measured: Collection[str]) -> str:
    """The form of the base that `program` is compared with: of its own precision, or the only one."""
    forms = [name for name in measured if name.startswith(f"{base} ")]
    same = f"{base} {program.rsplit(maxsplit=1)[-1]}"
    return same if same in forms else forms[0]
