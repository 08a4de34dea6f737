"""The body on the virtual rig in MuJoCo: hubs, strips and coils of a robot with deviations from the nominal
one.

The only module that imports mujoco. Nothing is set for the whole process (no `mjcb_` callback), so that two
rigs in one process do not disturb each other.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from eldir.core.arguments import require_value
from eldir.core.records import FloatArray
from eldir.errors import MissingDependencyError, divergence_error
from eldir.morphology import Morphology
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters, sample_feet
from eldir.parameters.springs import SpringParameters
from eldir.terrain import Terrain
from eldir_cad.kit import PRINTER
from eldir_cad.kit.printer import load_printer
from eldir_cad.kit.specification import load_specification
from eldir_cad.multibody.biplane import Biplane
from eldir_cad.multibody.hubs import hub_name
from eldir_cad.multibody.mjcf import mjcf_text
from eldir_cad.multibody.model import Multibody, build_multibody
from eldir_hardware.virtual.impossible_motion import ImpossibleMotion

TILT_SCATTER = np.deg2rad(0.2)
"""Standard deviation of the table's slope [rad]: a table that was levelled with a spirit level."""
_MAX_SPEED = 1e3  # speed beyond which the simulation has failed [m/s, rad/s]; MuJoCo itself goes on to 1e10
_COMMAND_INTERVAL = 1e-3
"""Free lengths are set this often [s]."""


class MujocoBody:
    """The robot of a design on the table, both faces, simulated step by step by MuJoCo."""

    def __init__(
        self,
        morphology: Morphology,
        seed: int,
        springs: SpringParameters,
        ballast: FloatArray | None = None,
        built: BuiltParameters | None = None,
        terrain: Terrain | None = None,
    ):
        """`ballast` [kg] on each hub, both faces together; `built`: parameters of the robot, else by `seed`.
        `terrain`: the ground, by default a table.

        The seed gives the same masses, stiffnesses and strips as `EngineBody` has with it. Each
        foot's friction and the table's slope are samples too. Raises `MissingDependencyError` without
        MuJoCo.
        """
        model = sample_multibody(morphology, seed, ballast, built, terrain, springs)
        self.motion = MujocoMotion(model, (springs.cold_length, springs.hot_length))
        self._lengths, self._springs = np.full((1, morphology.motors), springs.cold_length), springs
        self._impossible, self._time = ImpossibleMotion(morphology, springs), 0.0
        self.springs = morphology.springs
        self.positions = self.motion.positions
        self.discs = None

    def move(self, lengths: FloatArray, interval: float) -> None:
        """Follow the mean free lengths of both faces; arguments as of `DrivenBody.move`."""
        table = np.concatenate([self._lengths, lengths[:, : self._lengths.shape[1]].mean(axis=2)])
        self.motion.follow(table, interval)
        self._lengths = table[-1:]
        self.positions = self.motion.positions
        self._time += len(lengths) * interval
        loads = self.motion.coil_loads(table[-1], self._springs)
        self._impossible.look(self._time, {"": self.positions}, loads)

    @property
    def remark(self) -> str:
        """As of `DrivenBody`."""
        return self._impossible.remark


class CoilDrivenMotion:
    """A robot in MuJoCo whose coils follow free lengths: what models in the plane and out of it share."""

    def __init__(self, xml: str, model: Multibody | Biplane, free: tuple[float, float]):
        """`free`: cold and hot free length [m], between which the stiffness goes from cold to hot."""
        self._engine = engine = _mujoco()
        self._robot, self._free = model, free
        self.model = engine.MjModel.from_xml_string(xml)
        """The compiled model (mujoco.MjModel)."""
        self.data = engine.MjData(self.model)
        """Its state (mujoco.MjData)."""
        engine.mj_kinematics(self.model, self.data)

    @property
    def coil_lengths(self) -> FloatArray:
        """Lengths of the coils between their hinges, at the last step [m], shape (A,)."""
        return np.array(self.data.actuator_length)

    def coil_loads(self, lengths: FloatArray, springs: SpringParameters) -> FloatArray:
        """Shortening of each coil between its hinges over the one at which it buckles, shape (A,); negative
        in tension. `lengths`: their free lengths between centres [m], shape (A,); `springs`: their size."""
        wanted, _ = self._robot.coil_commands(lengths[None], self._free)
        shortened: FloatArray = wanted[0] - self.coil_lengths
        return shortened / springs.buckling_shortening(lengths)

    def follow(self, lengths: FloatArray, interval: float) -> None:
        """Move by free lengths [m] at instants 0, `interval`, ... [s], linear between them, shape (K + 1, A).

        Raises `InputError` for an interval that is no multiple of the time step, `EldirError` where the
        simulation blows up.
        """
        step = self.model.opt.timestep
        total, steps = round(interval / step), max(1, round(_COMMAND_INTERVAL / step))
        whole = total >= 1 and abs(total * step - interval) <= 1e-6 * interval
        require_value("interval", whole, f"a multiple of the step, n x {step:g} s", f"{interval:g} s")
        steps = steps if total % steps == 0 else 1
        commands = total // steps
        wanted, forces = self._robot.coil_commands(lengths, self._free)
        for before in range(len(lengths) - 1):
            for command in range(commands):
                part = (command + 0.5) / commands
                self._command(
                    wanted[before] + part * (wanted[before + 1] - wanted[before]),
                    forces[before] + part * (forces[before + 1] - forces[before]),
                )
                self._engine.mj_step(self.model, self.data, steps)
                if not np.abs(self.data.qvel).max(initial=0.0) < _MAX_SPEED:
                    raise divergence_error("the virtual robot's body")

    def _command(self, lengths: FloatArray, stiffness: FloatArray) -> None:
        self.data.ctrl[:] = lengths
        self.model.actuator_gainprm[:, 0] = stiffness
        self.model.actuator_biasprm[:, 1] = -stiffness


class MujocoMotion(CoilDrivenMotion):
    """A multibody model in MuJoCo that moves in its plane."""

    def __init__(self, model: Multibody, free: tuple[float, float]):
        """`free`: as of `CoilDrivenMotion`."""
        super().__init__(mjcf_text(model), model, free)
        self._multibody = model
        names = [hub_name(i) for i in range(len(model.hubs))]
        self._hubs = [self.model.body(name).id for name in names]
        self._feet = [self.model.geom(f"{name}_foot").id for name in names]
        self._friction = self.model.geom_friction[self._feet, 0].copy()

    @property
    def positions(self) -> FloatArray:
        """Centres of the hubs over the table [m], shape (M, 2)."""
        return np.array(self.data.xpos[self._hubs][:, [0, 2]])

    def _command(self, lengths: FloatArray, stiffness: FloatArray) -> None:
        super()._command(lengths, stiffness)
        if self._multibody.parameters.backward_friction != 1.0:
            self._choose_friction()

    def _choose_friction(self) -> None:
        """A contact of MuJoCo has one coefficient for both directions: that of the way in which the lowest
        point of each hub moves now."""
        speeds = self.data.qvel.reshape(len(self._hubs), -1)
        sliding = speeds[:, 0] + self._multibody.corner * speeds[:, 2:].sum(axis=1)
        factor = np.where(sliding < 0, self._multibody.parameters.backward_friction, 1.0)
        self.model.geom_friction[self._feet, 0] = factor * self._friction


def sample_multibody(
    morphology: Morphology,
    seed: int,
    ballast: FloatArray | None = None,
    built: BuiltParameters | None = None,
    terrain: Terrain | None = None,
    springs: SpringParameters | None = None,
) -> Multibody:
    """The robot that a seed gives, as `MujocoBody` has it; it needs no MuJoCo. `springs`: nominal ones, by
    default the kit's."""
    rng = np.random.default_rng([seed, 2])
    nominal = RobotParameters.nominal(springs or SpringParameters()).printed
    own = nominal.perturb(rng) if built is None else built
    strips = own.geometry * rng.standard_normal(len(morphology.springs))
    further = np.random.default_rng([seed, 6])
    return build_multibody(
        morphology,
        load_specification(),
        load_printer(PRINTER),
        own,
        ballast=ballast,
        strip_extensions=strips,
        friction_factors=sample_feet(len(morphology.positions), further),
        tilt=float(TILT_SCATTER * further.standard_normal()),
        terrain=terrain,
    )


def mujoco_version() -> str:
    """MuJoCo with its version. Raises `MissingDependencyError` without it."""
    return f"MuJoCo {_mujoco().__version__}"


def _mujoco() -> Any:
    try:
        import mujoco
    except ImportError:
        raise MissingDependencyError(
            "MuJoCo is not installed",
            remedy="pip install 'eldir[mujoco]' (a rig file may set virtual.physics to eldir instead)",
        ) from None
    return mujoco
