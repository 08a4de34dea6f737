"""The robot on the virtual rig, moved by the physics that the rig file names, here or in a worker process."""

from __future__ import annotations

import signal
from collections.abc import Collection
from contextlib import suppress
from dataclasses import replace
from importlib.util import find_spec
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any, Literal

import numpy as np

from eldir.core.records import FloatArray
from eldir.errors import EldirError, divergence_error
from eldir.morphology import Morphology
from eldir.parameters.annotations import LargeSpread, field_annotations
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.wiring import FACES
from eldir.terrain import Terrain
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.virtual.impossible_motion import describe_buckling
from eldir_hardware.virtual.rig import DrivenBody

Physics = Literal["eldir", "mujoco"]
Dimensions = Literal[2, 3]
_SAMPLED_FIRST = "cold_length", "hot_length"
"""Springs' fields before the others, by which seeds give the same robots as before."""


def virtual_body(
    physics: Physics,
    morphology: Morphology,
    seed: int,
    springs: SpringParameters,
    ballast: FloatArray,
    built: BuiltParameters | None = None,
    terrain: Terrain | None = None,
    dimensions: Dimensions = 2,
) -> DrivenBody:
    """The robot of a design, with deviations from the nominal one by the seed.

    `ballast` [kg] on each mass, both faces together, shape (M,); `built`: parameters of the robot, else by
    `seed`; `terrain`: the ground, by default a table; `dimensions`: 3 in MuJoCo alone. Raises
    `MissingDependencyError` where the physics is not installed.
    """
    if dimensions == 3:
        from eldir_hardware.virtual.biplane_body import BiplaneBody

        return BiplaneBody(morphology, seed, springs, ballast, built, terrain)
    if physics == "mujoco":
        from eldir_hardware.virtual.mujoco_body import MujocoBody

        return MujocoBody(morphology, seed, springs, ballast, built, terrain)
    return EngineBody(morphology, seed, springs, ballast / 2, built, terrain)


def default_physics() -> Physics:
    """MuJoCo where it is installed: the prediction and the filmed robot then share no simulation."""
    return "mujoco" if find_spec("mujoco") else "eldir"


def physics_version(physics: Physics) -> str:
    """The program that moves the robot, with its version."""
    if physics == "mujoco":
        from eldir_hardware.virtual.mujoco_body import mujoco_version

        return mujoco_version()
    from eldir.core.version import __version__

    return f"eldir {__version__}"


def find_parameters(rig: Rig) -> tuple[BuiltParameters | None, SpringParameters]:
    """Parameters of the robot of a virtual rig by its `parameter_spread`: of its parts, None where
    `virtual_body` takes them from the seed, and the springs from which its own deviate."""
    if rig.virtual.parameter_spread == "large":
        far = far_robot(rig)
        return far.printed, far.springs
    return None, rig.spring_parameters()


def far_robot(rig: Rig) -> RobotParameters:
    """The robot of a virtual rig with `parameter_spread: large`."""
    nominal, known = RobotParameters.nominal(rig.spring_parameters()), rig.tolerances.measured_fields
    return sample_large_spread(nominal, rig.virtual.seed, measured=known)


def sample_large_spread(
    nominal: RobotParameters, seed: int, *, measured: Collection[str] = ()
) -> RobotParameters:
    """A robot far from the nominal one, for an identification on a virtual rig: as far as each `LargeSpread`
    says, and in all other fields as printed robots differ. With more, it would fall or stand still.
    `measured`: fields of its springs that stay nominal; the others are as without it."""
    rng = np.random.default_rng([seed, 4])
    built, springs = nominal.printed, nominal.springs
    spreads = dict(
        field_annotations(BuiltParameters, LargeSpread) + field_annotations(SpringParameters, LargeSpread)
    )
    # Both stiffnesses are off by one factor, and the hot one by a tenth more or less.
    factors = dict.fromkeys(("cold_stiffness", "hot_stiffness"), spreads["cold_stiffness"].sample(rng))
    hot_to_cold = float(rng.uniform(0.9, 1.1))

    def values(part: BuiltParameters | SpringParameters) -> dict[str, Any]:
        own = [name for name in dict.fromkeys([*_SAMPLED_FIRST, *spreads]) if hasattr(part, name)]
        factors.update((name, spreads[name].sample(rng)) for name in own if name not in factors)
        return {name: getattr(part, name) * factors[name] for name in own}

    built = replace(built.perturb(rng), **values(built))
    built = replace(built, hot_stiffness=built.hot_stiffness * hot_to_cold)
    springs = replace(springs.perturb(rng), **values(springs))
    known = {name: getattr(nominal.springs, name) for name in measured}
    return RobotParameters(built, replace(springs, **known))


class EngineBody:
    """One plane of the robot on the ground, simulated step by step by eldir's engine."""

    def __init__(
        self,
        morphology: Morphology,
        seed: int,
        springs: SpringParameters,
        ballast: float | FloatArray = 0.0,
        built: BuiltParameters | None = None,
        terrain: Terrain | None = None,
    ):
        """`ballast` [kg] of this plane, as in `build`; `built`: parameters of the robot, else by `seed`;
        `terrain`: the ground, by default a table."""
        from eldir.built.ground import place
        from eldir.built.robot import build  # the engine takes seconds to import

        rng = np.random.default_rng([seed, 2])
        own = RobotParameters.nominal(springs).printed.perturb(rng) if built is None else built
        self._robot = build(morphology, RobotParameters(own, springs), ballast=ballast, rng=rng)
        self._free = (springs.cold_length, springs.hot_length)
        self._lengths = np.full((1, morphology.motors), springs.cold_length)
        self._terrain, self._state = terrain, place(self._robot, terrain)
        self.remark, self._time = "", 0.0
        self._morphology = morphology
        self.springs = morphology.springs
        self.positions = self._state[:2].T
        self.discs = None

    def move(self, lengths: FloatArray, interval: float) -> None:
        """Move by the mean free lengths of both faces; arguments as of `DrivenBody.move`."""
        from eldir.built.motion import OK, drive
        from eldir.built.walking import coil_load

        table = np.concatenate([self._lengths, lengths[:, : self._lengths.shape[1]].mean(axis=2)])
        (motion,) = drive(
            [self._robot],
            [table],
            interval,
            states=[self._state],
            every=len(lengths),
            free=self._free,
            terrain=self._terrain,
        )
        if motion.status != OK:
            raise divergence_error("the virtual robot's body")
        self._state = motion.state
        self._lengths = table[-1:]
        self.positions = motion.positions[-1]
        self._time += len(lengths) * interval
        if not self.remark:  # strips and coils have no width here: nothing overlaps
            loads = coil_load(self._robot, motion, table[[0, -1]])
            self.remark = describe_buckling(self._morphology, loads[-1], self._time)


class BodyProcess:
    """A `DrivenBody` of the virtual rig in a worker process: its engine would block the threads of this one.

    It is ready when the constructor returns.
    """

    def __init__(
        self,
        physics: Physics,
        morphology: Morphology,
        seed: int,
        springs: SpringParameters,
        ballast: FloatArray,
        built: BuiltParameters | None = None,
        terrain: Terrain | None = None,
        dimensions: Dimensions = 2,
    ):
        """The robot of `virtual_body`, with the same parameters and errors."""
        context = get_context("spawn")
        self._connection, other = context.Pipe()
        self._process = context.Process(
            target=_serve,
            args=(other, physics, morphology, seed, springs, ballast, built, terrain, dimensions),
            daemon=True,
        )
        self._process.start()
        other.close()
        self.remark = ""
        try:
            self.springs, self.positions, self.discs = self._receive()
        except BaseException:
            self.close()
            raise

    def move(self, lengths: FloatArray, interval: float) -> None:
        """As `DrivenBody.move`."""
        try:
            self._connection.send((lengths, interval))
        except OSError:
            raise self._died() from None
        self.positions, self.discs, self.remark = self._receive()

    def close(self) -> None:
        """End the worker process."""
        self._process.kill()
        self._process.join()
        self._connection.close()

    def __enter__(self) -> BodyProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _receive(self) -> Any:
        try:
            reply = self._connection.recv()
        except (EOFError, ConnectionError):
            raise self._died() from None
        if isinstance(reply, EldirError):
            raise reply
        return reply

    @staticmethod
    def _died() -> EldirError:
        return EldirError("the virtual robot's process died", remedy="drive again")


def _serve(
    connection: Connection,
    physics: Physics,
    morphology: Morphology,
    seed: int,
    springs: SpringParameters,
    ballast: FloatArray,
    built: BuiltParameters | None,
    terrain: Terrain | None,
    dimensions: Dimensions,
) -> None:
    from eldir.core import program_log

    program_log.configure("virtual robot")
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # a stop may reach the whole process group
        signal.signal(number, signal.SIG_IGN)  # the parent ends this process
    try:
        # Another body moves for a moment: the engine compiles now.
        given = physics, morphology, seed, springs, ballast, built, terrain, dimensions
        spare = virtual_body(*given)
        spare.move(np.full((1, morphology.motors, len(FACES)), springs.cold_length), 0.05)
        body = virtual_body(*given)
        connection.send((body.springs, body.positions, body.discs))
        while True:
            body.move(*connection.recv())
            connection.send((body.positions, body.discs, body.remark))
    except (EOFError, ConnectionError):  # the parent has ended
        return
    except EldirError as error:
        with suppress(ConnectionError):
            connection.send(error)
