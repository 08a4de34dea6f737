"""The robot in MuJoCo with its two faces apart: it may twist, turn and fall over sideways."""

from __future__ import annotations

import numpy as np

from eldir.core.records import FloatArray
from eldir.morphology import Morphology
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters, sample_feet
from eldir.parameters.springs import SpringParameters
from eldir.parameters.wiring import FACES
from eldir.terrain import Terrain
from eldir_cad.kit import PRINTER
from eldir_cad.kit.printer import load_printer
from eldir_cad.kit.specification import load_specification
from eldir_cad.multibody.biplane import Biplane, build_biplane
from eldir_cad.multibody.biplane_mjcf import biplane_mjcf, disc_name
from eldir_cad.multibody.hubs import face_side
from eldir_hardware.camera.projection import DiscPoses
from eldir_hardware.virtual.impossible_motion import ImpossibleMotion
from eldir_hardware.virtual.mujoco_body import TILT_SCATTER, CoilDrivenMotion


class BiplaneBody:
    """The robot of a design on the table with its two faces apart, simulated step by step by MuJoCo."""

    def __init__(
        self,
        morphology: Morphology,
        seed: int,
        springs: SpringParameters,
        ballast: FloatArray | None = None,
        built: BuiltParameters | None = None,
        terrain: Terrain | None = None,
    ):
        """As `MujocoBody`; the robot of `sample_biplane`."""
        self._model = sample_biplane(morphology, seed, ballast, built, terrain, springs)
        self.motion = BiplaneMotion(self._model, (springs.cold_length, springs.hot_length))
        self._lengths = np.full((1, len(FACES) * morphology.motors), springs.cold_length)
        self._springs = springs
        self._impossible, self._time = ImpossibleMotion(morphology, springs), 0.0
        self.springs = morphology.springs

    @property
    def positions(self) -> FloatArray:
        """Middles of the hubs in the plane in which the robot was put [m], shape (M, 2)."""
        return self.motion.positions

    @property
    def discs(self) -> DiscPoses:
        """Current places of the discs of both faces."""
        model, rotations = self._model, self.motion.rotations
        sides = np.array([face_side(face) for face in FACES])
        across = sides[:, None] * (model.outside - model.springs_at) * np.array([0.0, 1.0, 0.0])
        outsides: FloatArray = self.motion.discs + np.einsum("mfij,fj->mfi", rotations, across)
        return DiscPoses(outsides + np.array([0.0, model.outside, 0.0]), rotations)

    def move(self, lengths: FloatArray, interval: float) -> None:
        """As `DrivenBody.move`."""
        motors = self._lengths.shape[1] // len(FACES)
        table = np.concatenate([self._lengths, lengths[:, :motors].reshape(len(lengths), -1)])
        self.motion.follow(table, interval)
        self._lengths = table[-1:]
        self._time += len(lengths) * interval
        faces = dict(zip(FACES, self.motion.discs.swapaxes(0, 1), strict=True))
        self._impossible.look(self._time, faces, self.motion.coil_loads(table[-1], self._springs))

    @property
    def remark(self) -> str:
        """As of `DrivenBody`."""
        return self._impossible.remark


class BiplaneMotion(CoilDrivenMotion):
    """A model of two faces in MuJoCo. Coils are in the order front and back of the first motor, front and
    back of the second."""

    def __init__(self, model: Biplane, free: tuple[float, float]):
        """`free`: as of `CoilDrivenMotion`."""
        super().__init__(biplane_mjcf(model), model, free)
        self._plane = model.plane
        names = [[disc_name(hub, face) for face in FACES] for hub in range(len(model.discs))]
        self._sites = np.array([[self.model.site(name).id for name in pair] for pair in names])
        self._feet = np.array([[self.model.geom(f"{name}_foot").id for name in pair] for pair in names])
        self._friction = self.model.geom_friction[self._feet, 0].copy()

    @property
    def discs(self) -> FloatArray:
        """Middles of the discs, front and back [m], shape (M, 2, 3)."""
        return np.array(self.data.site_xpos[self._sites])

    @property
    def rotations(self) -> FloatArray:
        """Rotations of the discs, front and back, from the upright robot, shape (M, 2, 3, 3)."""
        return np.array(self.data.site_xmat[self._sites]).reshape(*self._sites.shape, 3, 3)

    @property
    def positions(self) -> FloatArray:
        """Middles of the hubs as a camera in front of the table would see them without perspective [m], shape
        (M, 2)."""
        return np.asarray(self.discs.mean(axis=1)[:, [0, 2]])

    def _command(self, lengths: FloatArray, stiffness: FloatArray) -> None:
        super()._command(lengths, stiffness)
        if self._plane.parameters.backward_friction != 1.0:
            self._choose_friction()

    def _choose_friction(self) -> None:
        """As in the plane, along the direction in which the robot looks."""
        data, bodies = self.data, self.model.geom_bodyid[self._feet]
        lowest = data.geom_xpos[self._feet] - [0.0, 0.0, self._plane.corner]
        origin = data.subtree_com[self.model.body_rootid[bodies]]
        spin, speed = data.cvel[bodies, :3], data.cvel[bodies, 3:]
        x, y, _ = (self.discs[:, 1] - self.discs[:, 0]).mean(axis=0)
        ahead = np.array([y, -x, 0.0]) / np.hypot(x, y)
        sliding = (speed + np.cross(spin, lowest - origin)) @ ahead
        factor = np.where(sliding < 0, self._plane.parameters.backward_friction, 1.0)
        self.model.geom_friction[self._feet, 0] = factor * self._friction


def sample_biplane(
    morphology: Morphology,
    seed: int,
    ballast: FloatArray | None = None,
    built: BuiltParameters | None = None,
    terrain: Terrain | None = None,
    springs: SpringParameters | None = None,
) -> Biplane:
    """The robot that a seed gives: the front face, the table's slope ahead and the common parameters are
    those of `sample_multibody`, with the same arguments; strips and feet of the back face and the slope
    sideways are samples of their own."""
    rng = np.random.default_rng([seed, 2])
    nominal = RobotParameters.nominal(springs or SpringParameters()).printed
    own = nominal.perturb(rng) if built is None else built
    front = rng.standard_normal(len(morphology.springs))
    further, behind = np.random.default_rng([seed, 6]), np.random.default_rng([seed, 8])
    masses = len(morphology.positions)
    feet = sample_feet(masses, further)
    tilt = float(TILT_SCATTER * further.standard_normal())
    back = behind.standard_normal(len(morphology.springs))
    return build_biplane(
        morphology,
        load_specification(),
        load_printer(PRINTER),
        own,
        ballast=ballast,
        strip_extensions=own.geometry * np.stack([front, back]),
        friction_factors=np.stack([feet, sample_feet(masses, behind)]),
        tilt=tilt,
        side_tilt=float(TILT_SCATTER * behind.standard_normal()),
        terrain=terrain,
    )
