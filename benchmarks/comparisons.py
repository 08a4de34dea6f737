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
from eldir.benchmark.measurement import time_in_turns
from eldir.controller import Controller
from eldir.core.kernels import Precision
from eldir.core.records import FloatArray
from eldir.errors import EldirError
from eldir.scene import Scene

PRECISIONS: tuple[Precision, ...] = ("f32", "f64")
_TOLERANCE_F64 = {"losses": 1e-9, "gradients": 1e-6}
"""Greatest difference in float64: of losses [m], and of gradients relative to their length."""
_TOLERANCE_F32 = {"losses": 1e-6, "gradients": 1e-2}
"""The same in float32 for the median robot: a few robots are chaotic, and amplify rounding."""


def against_c(kind: str, robots: int, turns: int, folder: Path) -> dict[str, Any]:
    """The engine and the C program, one thread each, processor time."""
    task = make_task(kind, robots, 5, Scene.preset("paper"))
    programs: dict[str, Callable[[], object]] = {}
    errors: dict[str, FloatArray] = {}
    for precision in PRECISIONS:
        program = by_hand.compile_program(folder, precision)
        results = [by_hand.gradient(program, task, i) for i in range(robots)]
        losses = np.array([loss for loss, _ in results])
        errors_of_gradients = _gradient_errors(task, [gradient for _, gradient in results])
        _require(f"C {precision}", losses, task, precision, errors_of_gradients)
        programs[f"C {precision}"] = by_hand.learning(program, task)
        programs[f"engine {precision}"] = engine.learning(task, precision, 1)
        errors[f"C {precision}"] = np.abs(losses - task.losses)
        errors[f"engine {precision}"] = np.abs(engine.first_losses(task, precision) - task.losses)
    seconds = time_in_turns(programs, turns, time.process_time)
    return _summary(task, seconds, errors, threads=1, clock="processor time", base="C")


def against_jax(kind: str, robots: int, turns: int, folder: Path) -> dict[str, Any]:
    """The engine and the scene in JAX, one thread each, processor time. The time to compile is reported
    separately."""
    task = make_task(kind, robots, 5, Scene.preset("paper"))
    task.save(folder / "task.npz")
    own = {f"engine {p}": engine.learning(task, p, 1) for p in PRECISIONS}
    errors = {f"engine {p}": np.abs(engine.first_losses(task, p) - task.losses) for p in PRECISIONS}
    script, compiled = Path(__file__).with_name("jax_program.py"), {}
    with ExitStack() as programs:
        others = {}
        for precision in PRECISIONS:
            name, gradients = f"JAX {precision}", folder / f"{precision}.npz"
            call: list[str | Path] = [sys.executable, script, folder / "task.npz", precision, gradients]
            others[name] = programs.enter_context(Program(call, folder / f"{precision}.txt"))
            start = time.perf_counter()
            _, losses = others[name].turn()  # compiles
            compiled[name] = round(time.perf_counter() - start, 1)
            _require(name, losses, task, precision, _gradient_errors(task, task.saved_gradients(gradients)))
            errors[name] = np.abs(losses - task.losses)
        for learn in own.values():
            learn()
        taken: dict[str, list[float]] = {name: [] for name in (*others, *own)}
        for _ in range(turns):
            for name, program in others.items():
                taken[name].append(program.turn()[0][1])
            for name, learn in own.items():
                spent = time.process_time()
                learn()
                taken[name].append(time.process_time() - spent)
    seconds = {name: np.array(t) for name, t in taken.items()}
    summary = _summary(task, seconds, errors, threads=1, clock="processor time", base="JAX")
    return summary | {"first_turn_s": compiled}


def _gradient_errors(task: Task, gradients: Sequence[Controller]) -> FloatArray:
    """Error of each robot's gradient, relative to its length."""
    pairs = zip(gradients, task.gradients, strict=True)
    return np.array([np.linalg.norm(m.flat - e.flat) / np.linalg.norm(e.flat) for m, e in pairs])


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
        for learn in own.values():
            learn()
        taken: dict[str, list[tuple[float, float]]] = {name: [] for name in ("released f64", *own)}
        for _ in range(turns):
            taken["released f64"].append(program.turn()[0])
            for name, learn in own.items():
                start, spent = time.perf_counter(), time.process_time()
                learn()
                taken[name].append((time.perf_counter() - start, time.process_time() - spent))
    seconds, processor = ({name: np.array(t)[:, c] for name, t in taken.items()} for c in (0, 1))
    summary = _summary(task, seconds, errors, threads=threads, clock="wall clock", base="released")
    for name, values in _summary(task, processor, errors, base="released")["programs"].items():
        summary["programs"][name]["processor_time"] = values
    return summary


def _require(
    name: str, losses: FloatArray, task: Task, precision: Precision, gradient_errors: FloatArray | None = None
) -> None:
    """Require equal results before times are measured."""
    for what, error in (("losses", np.abs(losses - task.losses)), ("gradients", gradient_errors)):
        if error is None:
            continue
        difference = float(np.max(error) if precision == "f64" else np.median(error))
        allowed = (_TOLERANCE_F64 if precision == "f64" else _TOLERANCE_F32)[what]
        if not difference <= allowed:
            raise EldirError(
                f"{what} of {name} differ from those of the engine",
                expected=f"at most {allowed:g}",
                found=f"{difference:g}",
            )


def _summary(
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
