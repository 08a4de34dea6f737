"""A terrain under the robot in MuJoCo: closed forms, and robots that walk as in the engine."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eldir.built.gait import Gait
from eldir.built.motion import drive
from eldir.built.robot import build
from eldir.built.walking import stays_upright
from eldir.errors import InputError
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.tolerances import RigTolerances
from eldir.terrain import Terrain
from eldir_cad.kit.printer import fit_to_printer, load_printer
from eldir_cad.kit.specification import load_specification
from eldir_calibration.transfer.mujoco_walks import walk_sampled_robot
from eldir_hardware.planning.model_export import export_robot
from eldir_hardware.virtual.bodies import EngineBody
from eldir_hardware.virtual.mujoco_body import MujocoBody, MujocoMotion, sample_multibody
from tests.cad.drawn_bodies import WHEEL
from tests.cad.drawn_bodies import design as drawn_design
from tests.calibration.dynamics.hidden_rigs import walker
from tests.eldir.built.grounds import plane, steps
from tests.hardware.virtual.multibody_models import FREE, hub, robot, small
from tests.raised import raises

pytest.importorskip("mujoco")


def rugged(seed: int) -> Terrain:
    """Ground of the paper's kind, as large as the printed robot needs it."""
    return Terrain.rugged(np.random.default_rng(seed)).scaled(BuiltParameters().scale)


def random_body(seed: int) -> Morphology:
    lattice = Lattice(3, 6) if seed % 2 else Lattice(4, 7)
    return develop(lattice, random_genotypes(lattice, 1, np.random.default_rng(seed), max_active=3)[0])


def test_a_slope_is_slippery_beyond_the_angle_of_friction() -> None:
    def slid(slope: float) -> float:
        motion = MujocoMotion(small([hub(0.0)], gravity=-9.81, terrain=plane(-slope)), FREE)
        motion.follow(np.zeros((3, 0)), 0.05)
        before = motion.positions[0, 0]
        motion.follow(np.zeros((11, 0)), 0.05)
        assert motion.positions[0, 1] == pytest.approx(-slope * motion.positions[0, 0], abs=2e-3)
        return float(motion.positions[0, 0] - before)

    assert abs(slid(0.49)) < 1e-4
    steep = np.arctan(0.55)
    acceleration = 9.81 * (np.sin(steep) - 0.5 * np.cos(steep)) * np.cos(steep)
    assert slid(0.55) == pytest.approx(0.5 * acceleration * (0.6**2 - 0.1**2), rel=0.2)


@pytest.mark.parametrize(
    ("body", "ground"),
    [
        pytest.param(walker().morphology, rugged(2), id="1-rugged"),
        pytest.param(random_body(65), plane(0.1), id="2-slope"),
        pytest.param(random_body(65), steps(), id="2-steps"),
        pytest.param(random_body(67), rugged(2), id="3-rugged"),
        pytest.param(walker().morphology, plane(0.1), id="1-slope", marks=pytest.mark.stress),
        pytest.param(walker().morphology, steps(), id="1-steps", marks=pytest.mark.stress),
        pytest.param(random_body(65), rugged(1), id="2-rugged", marks=pytest.mark.stress),
        pytest.param(random_body(67), plane(0.1), id="3-slope", marks=pytest.mark.stress),
    ],
)
def test_robots_walk_nearly_as_in_the_engine(body: Morphology, ground: Terrain) -> None:
    """In eight seconds with motors that stretch in turn, they move up to 7 cm."""
    t = np.arange(161)[:, None] * 0.05
    heated = (1 - np.cos(2 * np.pi * t / 4 - 0.5 * np.pi * np.arange(body.motors))) / 4 * np.minimum(t, 1)
    lengths = FREE[0] + (FREE[1] - FREE[0]) * heated
    own = build(body, BuiltParameters().with_hubs())
    (there,) = drive([own], [lengths], 0.05, terrain=ground)
    assert stays_upright(own, there, lengths)
    motion = MujocoMotion(replace(robot(body), terrain=ground), FREE)
    start = motion.positions
    motion.follow(lengths, 0.05)
    mujoco = (motion.positions - start).mean(axis=0)
    engine = (there.positions[-1] - there.positions[0]).mean(axis=0)
    assert np.abs(start - there.positions[0] - [0, own.parameters.corner]).max() < 1e-4
    assert np.abs(mujoco - engine).max() < max(0.005, 0.1 * np.abs(engine).max())


def test_a_body_of_the_rig_stands_on_the_terrain() -> None:
    body, ground = walker().morphology, rugged(2)
    model = sample_multibody(body, 3, terrain=ground)
    motion = MujocoBody(body, 3, SpringParameters(), terrain=ground)
    assert model.lift > 0.05
    corners = motion.positions[:, 1] - model.corner - ground.height(motion.positions[:, 0])
    assert -0.004 < corners.min() < 0.01
    plane_of_engine = EngineBody(body, 3, SpringParameters(), terrain=ground)
    cold = np.full((20, body.motors, 2), FREE[0])
    for there in (motion, plane_of_engine):
        there.move(cold, 0.05)
    centres = motion.positions - [0, model.corner]
    assert np.abs(centres - plane_of_engine.positions).max() < 0.004
    with raises(InputError, "input.wrong-value", "terrain"):
        MujocoBody(body, 3, SpringParameters(), terrain=plane(30.0))


def test_an_exported_robot_stands_on_its_ground(tmp_path: Path) -> None:
    """MuJoCo itself opens the file; in it the robot stands on the rugged ground, not on a table."""
    mujoco = pytest.importorskip("mujoco")
    spec = fit_to_printer(load_specification(), load_printer())
    ground = rugged(2)
    heights = []
    for name, terrain in (("table", None), ("ground", ground)):
        design = replace(drawn_design(*WHEEL), printed_terrain=terrain)
        export_robot(design, tmp_path / f"{name}.xml", spec, load_printer())
        model = mujoco.MjModel.from_xml_path(str(tmp_path / f"{name}.xml"))
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 300)
        heights.append(data.xpos[1:, 2].min())
    assert heights[0] == pytest.approx(0.007, abs=0.002)
    assert heights[1] > 0.05


def test_a_walk_in_mujoco_is_on_the_ground_of_its_design() -> None:
    """A cold robot stands still on the table, and turns over on a slope of 42 degrees."""
    design = drawn_design(*WHEEL)
    cold = Gait(3.0, np.zeros(1), np.array([0.01]))
    given = cold, 3, SpringParameters(), RigTolerances(), 1
    table = walk_sampled_robot(design, *given)
    slope = walk_sampled_robot(replace(design, printed_terrain=plane(-0.9)), *given)
    assert table.fault == "" and abs(table.displacement) < 0.05
    assert slope.fault == "turns over"


@pytest.mark.parametrize("start", [-30.0, 0.0, 30.0])
def test_the_first_and_the_last_segment_have_no_end(start: float) -> None:
    """Wherever the terrain's segments begin, there is ground under the robot, before it and behind it."""
    ground = Terrain(start + np.array([0.0, 0.1]), np.zeros(2), np.full(2, 0.05))
    for place in (0.0, 0.25, 8.0, -8.0):
        motion = MujocoMotion(small([hub(0.0), hub(0.5)], gravity=-9.81, terrain=ground), FREE)
        motion.data.qpos[0] += place
        motion.follow(np.zeros((6, 0)), 0.05)
        assert motion.positions[0] == pytest.approx([place, 0.05], abs=1e-3)
