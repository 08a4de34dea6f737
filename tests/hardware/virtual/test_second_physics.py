"""MuJoCo behind the virtual rig: closed forms, conservation, and the built scene where both say the same."""

from __future__ import annotations

import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from eldir.built.motion import drive
from eldir.built.robot import build
from eldir.built.walking import stays_upright
from eldir.errors import EldirError, InputError, MissingDependencyError
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters
from eldir_cad.multibody.hubs import hub_name
from eldir_cad.multibody.mjcf import mjcf_text
from eldir_cad.multibody.model import CoilSpring, Multibody, Numerics
from eldir_hardware.virtual.bodies import EngineBody
from eldir_hardware.virtual.mujoco_body import MujocoBody, MujocoMotion, sample_multibody
from tests.calibration.dynamics.hidden_rigs import walker
from tests.hardware.virtual.multibody_models import (
    BENDING,
    BUCKLING,
    FREE,
    LENGTH,
    TENSION,
    hub,
    pinned,
    robot,
    small,
    strip,
)
from tests.raised import raises

mujoco = pytest.importorskip("mujoco")  # installed with the extra `test`
BODY = walker().morphology
NONE = np.zeros((2, 0))


def rest(motion: MujocoMotion, seconds: float, lengths: float = FREE[0]) -> np.ndarray:
    """Positions after a time with all coils at one free length."""
    table = np.full((round(seconds / 0.05) + 1, motion.model.nu), lengths)
    motion.follow(table, 0.05)
    return motion.positions


@pytest.mark.parametrize(("friction", "backward"), [(0.2, 1.0), (0.5, 1.0), (0.3, 2.5)])
@pytest.mark.parametrize("speed", [1.0, -1.0])
def test_a_block_slides_as_far_as_coulomb_says(friction: float, backward: float, speed: float) -> None:
    model = small([hub(0.0, friction=friction)], gravity=-9.81, backward_friction=backward)
    motion = MujocoMotion(model, FREE)
    rest(motion, 0.2)
    motion.data.qvel[0] = speed
    before = motion.positions[0, 0]
    after = rest(motion, 0.7)[0, 0]
    expected = speed / (2 * friction * (backward if speed < 0 else 1.0) * 9.81)
    assert after - before == pytest.approx(expected, rel=3e-3)


def test_friction_is_that_of_the_way_in_which_the_lowest_points_move() -> None:
    """Hubs that spin: in many of them the lowest point moves otherwise than the centre. That is read
    from MuJoCo's poses before and after a short time."""
    motion = MujocoMotion(
        sample_multibody(BODY, 4, built=BuiltParameters(backward_friction=2.5).with_hubs()), FREE
    )
    model, data, hubs = motion.model, motion.data, len(motion.positions)
    feet = [model.geom(f"{hub_name(i)}_foot").id for i in range(hubs)]
    bodies = model.geom_bodyid[feet]
    grip, corner = model.geom_friction[feet, 0].copy(), BuiltParameters().with_hubs().corner
    rng, against = np.random.default_rng(1), 0
    for _ in range(5):
        mujoco.mj_resetData(model, data)
        data.qvel[:] = rng.normal(0.0, np.tile([0.1, 0.1, 20.0], hubs))
        mujoco.mj_kinematics(model, data)
        lowest = data.xpos[bodies] - [0.0, 0.0, corner]
        own = np.einsum("hij,hi->hj", data.xmat[bodies].reshape(-1, 3, 3), lowest - data.xpos[bodies])
        later = mujoco.MjData(model)
        later.qpos[:] = data.qpos
        mujoco.mj_integratePos(model, later.qpos, data.qvel, 1e-6)
        mujoco.mj_kinematics(model, later)
        moved = (
            later.xpos[bodies] + np.einsum("hij,hj->hi", later.xmat[bodies].reshape(-1, 3, 3), own) - lowest
        )
        against += int((moved[:, 0] * data.qvel[::3] < 0).sum())
        motion.follow(np.full((2, model.nu), FREE[0]), model.opt.timestep)
        factor = np.where(moved[:, 0] < 0, 2.5, 1.0)
        assert model.geom_friction[feet, 0] == pytest.approx(factor * grip)
    assert against > hubs


def walks_in_both(body: Morphology, backward: float) -> tuple[float, float]:
    """Displacement [m] in eight seconds with motors that stretch in turn, in the engine and in MuJoCo: with
    pins and equal feet in both."""
    t = np.arange(161)[:, None] * 0.05
    heated = (1 - np.cos(2 * np.pi * t / 4 - 0.5 * np.pi * np.arange(body.motors))) / 4 * np.minimum(t, 1)
    lengths = FREE[0] + (FREE[1] - FREE[0]) * heated
    own = build(body, BuiltParameters(backward_friction=backward))
    (moved,) = drive([own], [lengths], 0.05)
    assert stays_upright(own, moved, lengths)
    motion = MujocoMotion(pinned(body, backward_friction=backward), FREE)
    start = rest(motion, 0.2)
    motion.follow(lengths, 0.05)
    there, here = motion.positions - start, moved.positions[-1] - moved.positions[0]
    return float(here[:, 0].mean()), float(there[:, 0].mean())


@pytest.mark.parametrize("seed", [None, 65, 67])
def test_teeth_on_the_feet_move_a_walk_forward_in_both_physics(seed: int | None) -> None:
    """MuJoCo's friction creeps before it holds, so that its robots gain up to a fifth less."""
    body = BODY
    if seed is not None:
        lattice = Lattice(3, 6) if seed % 2 else Lattice(4, 7)
        body = develop(lattice, random_genotypes(lattice, 1, np.random.default_rng(seed), max_active=3)[0])
    (before, before_there), (after, after_there) = (walks_in_both(body, b) for b in (1.0, 3.0))
    assert after - before > 0.02
    assert after_there - before_there == pytest.approx(after - before, rel=0.25)


def test_a_tilted_table_is_slippery_beyond_the_angle_of_friction() -> None:
    def slid(tilt: float) -> float:
        motion = MujocoMotion(small([hub(0.0)], gravity=-9.81, tilt=tilt), FREE)
        rest(motion, 0.1)
        before = motion.positions[0, 0]
        return float(rest(motion, 1.0)[0, 0] - before)

    assert abs(slid(np.arctan(0.49))) < 1e-4
    steep = np.arctan(0.6)
    assert slid(steep) == pytest.approx(0.5 * 9.81 * (np.sin(steep) - 0.5 * np.cos(steep)) * 1.1**2, rel=0.2)


@pytest.mark.parametrize("numerics", [Numerics(), Numerics(contact_time=0.02, impratio=1.0, impedance=0.9)])
def test_a_block_that_sticks_creeps_by_what_its_contact_yields(numerics: Numerics) -> None:
    """(1 - d) T a / 2 impratio under a tangential load of a [m/s2]: 15 um in a schedule, or 0.45 m."""
    tilt = np.arctan(0.4)
    motion = MujocoMotion(small([hub(0.0)], gravity=-9.81, tilt=tilt, numerics=numerics), FREE)
    before = rest(motion, 1.0)[0, 0]
    speed = rest(motion, 1.0)[0, 0] - before
    yields = (1 - numerics.impedance) * numerics.contact_time / (2 * numerics.impratio)
    assert speed == pytest.approx(yields * 9.81 * np.sin(tilt), rel=1e-3)


def test_a_fall_is_slowed_by_its_drag() -> None:
    motion = MujocoMotion(small([hub(0.0, 1.0)], gravity=-9.81, drag=2.0), FREE)
    motion.model.body_pos[1, 2] = 1.0
    motion.data.qpos[1] = 0.0
    rest(motion, 0.3)
    fallen = 9.81 / 2 * (0.3 - (1 - np.exp(-0.6)) / 2)
    assert -motion.data.qpos[1] == pytest.approx(fallen, rel=2e-3)


def test_two_masses_swing_on_a_coil() -> None:
    coil = CoilSpring((0, 1), (1000.0, 1000.0), 0.0)
    motion = MujocoMotion(small([hub(0.0, mass=2e-3), hub(0.05, mass=3e-3)], coils=[coil]), FREE)
    motion.data.qpos[0] = -1e-3
    motion.data.ctrl[:] = 0.05
    apart = []
    for _ in range(4000):
        mujoco.mj_step(motion.model, motion.data)
        apart.append(motion.data.ten_length[0] - 0.05)
    crossings = np.flatnonzero(np.diff(np.sign(apart)) > 0)
    periods = len(crossings) - 1
    found = periods / ((crossings[-1] - crossings[0]) * motion.model.opt.timestep)
    assert found == pytest.approx(np.sqrt(1000 / 1.2e-3) / (2 * np.pi), rel=5e-3)


@pytest.mark.parametrize("force", [3.0, 0.5, -0.5, -0.95 * BUCKLING])
def test_a_strip_is_as_stiff_as_it_is_up_to_eulers_load(force: float) -> None:
    motion = pulled(force)
    assert motion.data.ten_length[0] - LENGTH == pytest.approx(force / TENSION, rel=0.02)


def test_a_strip_buckles_at_eulers_load_and_then_carries_a_little_more() -> None:
    """PE (1 + s / 2L), as in the built scene."""
    motion = pulled(-1.01 * BUCKLING)
    assert LENGTH - motion.data.ten_length[0] == pytest.approx(0.02 * LENGTH, rel=0.02)


def pulled(force: float) -> MujocoMotion:
    motion = MujocoMotion(small([hub(0.0), hub(LENGTH)], [strip()], drag=20.0), FREE)
    motion.data.xfrc_applied[1:, 0] = -force, force
    rest(motion, 2.0)
    return motion


def levered(max_rotation: float | None = np.radians(15), friction: float = 0.0) -> Multibody:
    """A light hub on a strip in the socket of one that nothing moves."""
    heavy = hub(0.0, 1.0, mass=1e3, inertia=1e3)
    return small(
        [heavy, hub(LENGTH + 7.4e-3, 1.0)], [strip()], socket=3.7e-3, corner=1e-3,
        max_rotation=max_rotation, drag=20.0, socket_friction=friction,
    )  # fmt: skip


def rotated(force: float, friction: float = 0.0) -> float:
    """Rotation of the strip in the heavy hub's socket under a force across it [degrees]."""
    motion = MujocoMotion(levered(friction=friction), FREE)
    place = motion.data.site("strip_00_b").xpos  # of the hinge in the light hub
    hinge = motion.data.site("strip_00_a").xpos.copy()
    for _ in range(100):  # across the strip, wherever that is now
        x, y = (place - hinge)[[0, 2]] / np.linalg.norm(place - hinge)
        motion.data.xfrc_applied[2, [0, 2]] = -force * y, force * x
        rest(motion, 0.05)
    return float(np.degrees(np.arctan2(*(place - hinge)[[2, 0]])))


@pytest.mark.parametrize("force", [0.05, 0.2, -0.2])
def test_a_strip_turns_to_the_end_of_its_socket_and_then_bends(force: float) -> None:
    """Beyond it, it is a cantilever: M / (3 E I / l). The force acts on the light hub's centre, 3.7 mm
    beyond."""
    beyond = np.degrees(abs(force) * (LENGTH + 3.7e-3) / (3 * BENDING))
    assert abs(rotated(force)) == pytest.approx(15 + beyond, abs=0.05 + 0.07 * beyond)


def test_a_socket_does_not_turn_below_its_friction() -> None:
    torque = 2e-4
    assert abs(rotated(0.8 * torque / LENGTH, torque)) < 0.6
    assert abs(rotated(1.5 * torque / LENGTH, torque)) > 14


def test_momentum_is_kept_without_contact() -> None:
    motion = MujocoMotion(robot(BODY, gravity=0.0, drag=0.0), FREE)
    motion.data.qpos.reshape(-1, 3)[:, 1] = 1.0
    rest(motion, 0.5, FREE[1])
    speeds = motion.data.qvel.reshape(-1, 3)
    model, data = motion.model, motion.data
    mujoco.mj_subtreeVel(model, data)
    mass = model.body_mass[1:]
    moved = mass @ np.abs(speeds[:, :2])
    assert np.abs(mass @ data.subtree_linvel[1:])[[0, 2]] == pytest.approx(0, abs=1e-7 * (1 + moved.max()))
    spins = [abs(float(v)) for v in data.subtree_angmom[0]]
    assert spins[1] < 1e-3 * (model.body_inertia[1:, 1].max() * np.abs(speeds[:, 2]).max() + 1e-9) + 1e-9


def test_energy_is_lost_and_never_gained() -> None:
    """A robot that is dropped, with coils that do not change."""
    model = robot(BODY)
    motion = MujocoMotion(model, FREE)
    motion.data.qpos.reshape(-1, 3)[:, 1] = 0.01
    energies = []
    for _ in range(40):
        rest(motion, 0.05, 0.0496)
        data = motion.data
        mujoco.mj_energyVel(motion.model, data)
        height = motion.model.body_mass[1:] @ data.xipos[1:, 2] * 9.81
        coils = 0.5 * model.coils[0].stiffness[0] * ((data.actuator_length - data.ctrl) ** 2).sum()
        energies.append((data.energy[1], data.energy[1] + height + coils))
    kinetic, total = np.array(energies).T
    assert (np.diff(total) < 1e-5).all(), "but for what the strips hold, 8e-5 J each when loaded"
    assert kinetic[-1] < 1e-9


def test_a_robot_that_stands_does_not_creep() -> None:
    """With MuJoCo's defaults it moves by millimetres over a schedule."""
    motion = MujocoMotion(robot(BODY), FREE)
    before = rest(motion, 4.0)
    after = rest(motion, 4.0)
    assert np.abs(after - before).max() / 4 * 123 < 5e-5


def test_standing_shapes_are_those_of_the_built_scene() -> None:
    """Pins at the centres and hubs that do not turn: the same laws by two programs."""
    there = build(BODY)
    table = np.full((201, BODY.motors), FREE[0])
    (motion,) = drive([there], [table], 0.05)
    here = rest(MujocoMotion(pinned(BODY), FREE), 10.0)
    shapes = [x - x.mean(axis=0) for x in (motion.positions[-1], here)]
    assert np.abs(shapes[0] - shapes[1]).max() < 3e-5


def test_the_compiled_model_is_the_one_that_was_meant() -> None:
    model = robot(BODY)
    found = MujocoMotion(model, FREE).model
    assert found.body_mass[1:] == pytest.approx([h.inertia.mass for h in model.hubs], rel=1e-9)
    assert found.opt.gravity[2] == pytest.approx(-9.81) and found.opt.impratio == 100
    # Limits yield with the strips' stiffness by MuJoCo's own inverse weights.
    rows = [found.tendon(f"strip_{i:02d}").id for i in range(len(model.strips))]
    time, impedance = found.tendon_solref_lim[rows, 0], found.tendon_solimp_lim[rows, 0]
    stiffness = 1 / ((1 - impedance) * time**2 * found.tendon_invweight0[rows])
    assert stiffness == pytest.approx([s.tension for s in model.strips], rel=1e-6)
    assert mjcf_text(model) == mjcf_text(robot(BODY))


def test_the_seed_decides_and_two_rigs_do_not_disturb_each_other() -> None:
    lengths = np.linspace(FREE[0], FREE[1], 11)[1:, None, None] * np.ones((BODY.motors, 2))

    def body(seed: int) -> MujocoBody:
        return MujocoBody(BODY, seed, SpringParameters())

    alone = [body(seed) for seed in (1, 2)]
    for one in alone:
        one.move(lengths, 0.05)
    together = [body(seed) for seed in (1, 2)]
    threads = [threading.Thread(target=one.move, args=(lengths, 0.05)) for one in together]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(np.array_equal(a.positions, b.positions) for a, b in zip(alone, together, strict=True))
    assert not np.allclose(alone[0].positions, alone[1].positions, atol=1e-6)
    feet = alone[0].motion.model.geom_friction
    assert np.std(np.log([f[0] for f in feet if f[0] > 0.01])) > 0.02, "each foot has its own friction"


def test_contacts_that_are_stiffer_change_little() -> None:
    coarse, fine = (
        rest(MujocoMotion(robot(BODY, numerics=n), FREE), 2.0, 0.06)
        for n in (Numerics(), Numerics(step=1e-4, contact_time=2e-4))
    )
    assert np.abs((coarse - coarse.mean(0)) - (fine - fine.mean(0))).max() < 1e-4


def test_without_mujoco_one_line_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'eldir\[mujoco\]'"):
        MujocoBody(BODY, 1, SpringParameters())


def test_a_simulation_that_fails_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes MUJOCO_LOG.TXT where it stands
    motion = MujocoMotion(robot(BODY), FREE)
    motion.data.qvel[:] = 1e4
    with raises(InputError, "input.wrong-value", "interval"):
        motion.follow(np.full((2, 2), FREE[0]), 0.0301)
    with raises(EldirError, "motion.blown-up"):
        rest(motion, 0.1)


def test_ballast_weighs() -> None:
    weights = np.zeros(len(BODY.positions))
    weights[3] = 9e-3
    plain, heavy = (
        MujocoBody(BODY, 1, SpringParameters(), ballast).motion.model.body_mass for ballast in (None, weights)
    )
    assert heavy - plain == pytest.approx([0, *weights], abs=1e-12)


def test_hubs_that_meet_push_each_other() -> None:
    motion = MujocoMotion(small([hub(0.0), hub(0.05)], corner=7e-3, max_rotation=0.2, drag=20.0), FREE)
    motion.data.xfrc_applied[1:, 0] = 0.1, -0.1
    first, second = rest(motion, 1.0)
    assert np.linalg.norm(first - second) == pytest.approx(2 * 6e-3, abs=2e-5)


def test_the_seed_gives_the_robot_that_the_built_scene_has() -> None:
    here = sample_multibody(BODY, 5)
    compiled = MujocoBody(BODY, 5, SpringParameters()).motion.model
    assert compiled.body_mass[1:] == pytest.approx([h.inertia.mass for h in here.hubs], rel=1e-9)
    there = EngineBody(BODY, 5, SpringParameters())._robot
    passive = ~BODY.active
    longer = there.rest_lengths[passive] - there.parameters.pitch
    assert [s.length - LENGTH for s in here.strips] == pytest.approx(longer, abs=1e-12)
    assert here.strips[0].tension == pytest.approx(2 * there.stiffness[passive][0])
    assert [h.inertia.mass for h in here.hubs] == pytest.approx(2 * there.masses, rel=0.05)


def test_masses_are_those_of_the_built_scene() -> None:
    found = np.array([h.inertia.mass for h in robot(BODY).hubs])
    assert found == pytest.approx(2 * build(BODY).masses, rel=0.05)
    assert found.sum() == pytest.approx(2 * build(BODY).masses.sum(), rel=0.01)
