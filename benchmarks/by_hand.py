"""The C program: compiled by this machine's compiler, called in this process on one thread."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.task import Task
from eldir.controller import Controller
from eldir.core.kernels import Precision
from eldir.core.records import FloatArray
from eldir.errors import EldirError

SOURCE = Path(__file__).with_name("learning.c")
FLAGS = ("-O3", "-march=native", "-ffast-math", "-funroll-loops", "-fPIC")
_TYPES = {"f32": ("-DREAL=float", "-DSINGLE"), "f64": ("-DREAL=double",)}


class Robot(ctypes.Structure):
    """`Robot` of learning.c."""

    _fields_ = (
        *((name, ctypes.c_int) for name in ("masses", "springs", "motors", "steps")),
        *(
            (name, ctypes.c_double)
            for name in ("dt", "gravity", "damping", "stiffness", "actuation", "omega", "ground")
        ),
        *((name, ctypes.c_void_p) for name in ("start", "ends", "rest", "motor")),
    )


def compile_program(folder: Path, precision: Precision, compiler: str = "cc") -> ctypes.CDLL:
    """Compile and load. Linked without -ffast-math, which would switch denormals off in the whole process."""
    made, library = folder / f"learning-{precision}.o", folder / f"learning-{precision}.so"
    for call in (
        [compiler, *FLAGS, *_TYPES[precision], "-c", str(SOURCE), "-o", str(made)],
        [compiler, "-shared", str(made), "-o", str(library), "-lm"],
    ):
        try:
            subprocess.run(call, check=True, capture_output=True, text=True)
        except FileNotFoundError:
            raise EldirError(f"there is no {compiler}", remedy="apt install gcc") from None
        except subprocess.CalledProcessError as error:
            raise EldirError("the C program was not compiled", found=error.stderr.strip()[:300]) from None
    program = ctypes.CDLL(str(library))
    program.gradient.restype = ctypes.c_double
    program.learn.argtypes = [
        ctypes.c_void_p,
        ctypes.c_void_p,
        ctypes.c_int,
        ctypes.c_double,
        ctypes.c_void_p,
    ]
    program.gradient.argtypes = [ctypes.c_void_p] * 3
    return program


def gradient(program: ctypes.CDLL, task: Task, i: int) -> tuple[float, Controller]:
    """Loss of robot `i` [m], and its gradient with respect to the controller."""
    robot, arrays = _robot(task, i)
    weights = task.controllers[i].flat.copy()
    slopes = np.empty_like(weights)
    loss = program.gradient(ctypes.byref(robot), weights.ctypes.data, slopes.ctypes.data)
    del arrays
    return float(loss), task.controllers[i].shaped(slopes)


def learning(program: ctypes.CDLL, task: Task) -> Callable[[], FloatArray]:
    """A call learns once, one robot after the other; returns the losses (n, iterations + 1) [m]."""
    robots = [_robot(task, i) for i in range(len(task.bodies))]
    return partial(_learn, program, task, robots)


def _learn(program: ctypes.CDLL, task: Task, robots: list[tuple[Robot, list[np.ndarray]]]) -> FloatArray:
    losses = np.empty((len(robots), task.iterations + 1))
    for i, (robot, _) in enumerate(robots):
        weights = task.controllers[i].flat.copy()
        status = program.learn(
            ctypes.byref(robot),
            weights.ctypes.data,
            task.iterations,
            task.update_length,
            losses[i].ctypes.data,
        )
        if status:
            raise EldirError(
                f"the C program does not take robot {i}", found="a mass with more than six springs"
            )
    return losses


def _robot(task: Task, i: int) -> tuple[Robot, list[np.ndarray]]:
    """The structure, and the arrays that it points to."""
    body, scene = task.bodies[i], task.scene
    motor = np.where(body.active, np.cumsum(body.active) - 1, -1)
    arrays: list[np.ndarray] = [
        np.ascontiguousarray(task.start(i), np.float64),
        np.ascontiguousarray(body.springs, np.int32),
        np.ascontiguousarray(body.rest_lengths, np.float64),
        np.ascontiguousarray(motor, np.int32),
    ]
    ground = float(scene.terrain.height(np.array(0.0)))
    robot = Robot(
        len(body.positions), len(body.springs), body.motors, scene.steps, scene.dt, scene.gravity,
        scene.damping, scene.stiffness, scene.actuation, scene.omega, ground,
        *(a.ctypes.data for a in arrays),
    )  # fmt: skip
    return robot, arrays
