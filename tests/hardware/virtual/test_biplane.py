"""The robot in MuJoCo with two faces: closed forms, conservation, and the planar model where both agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from eldir.genotype import Genotype
from eldir.lattice import Lattice
from eldir.morphology import develop
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.wiring import FACES
from eldir.terrain import Terrain
from eldir_cad.checks.tipping import lateral_rotation
from eldir_cad.kit.printer import load_printer
from eldir_cad.kit.specification import load_specification
from eldir_cad.multibody.biplane import (
    Biplane,
    ConnectorStiffness,
    FaceParts,
    build_biplane,
    connector_stiffness,
    with_lateral_rotation,
    with_yielding_connectors,
)
from eldir_cad.multibody.biplane_mjcf import biplane_mjcf
from eldir_cad.multibody.discs import DiscPair, Joining
from eldir_cad.multibody.hubs import Inertia
from eldir_cad.multibody.model import CoilSpring, Hub, Multibody, Strip
from eldir_hardware.virtual.biplane_body import BiplaneMotion, sample_biplane
from eldir_hardware.virtual.mujoco_body import MujocoMotion, sample_multibody
from tests.calibration.transfer.made_up_walks import tiny_design
from tests.hardware.virtual.multibody_models import FREE, LENGTH, hub, robot, small, strip

mujoco = pytest.importorskip("mujoco")  # installed with the extra `test`
SPEC, PRINTER = load_specification(), load_printer("xip")
TINY = tiny_design({}).morphology
SOCKET, APART, OUTSIDE = 3.7e-3, 0.02, 0.025
HALF_BENDING = strip().bending / 2


def biplane(
    plane: Multibody, joining: Joining = "rigid", lateral: float = 0.1, apart: float = APART
) -> Biplane:
    """The planar model with half of everything on each face."""
    discs = []
    for one in plane.hubs:
        half, across = one.inertia.mass / 2, np.array([0.0, apart, 0.0])
        halves = [Inertia(half, sign * across, one.inertia.tensor / 2) for sign in (-1, 1)]
        discs.append(DiscPair(*halves, joining))
    strips = [Strip(s.hubs, s.length, s.tension / 2, s.buckling / 2, s.bending / 2) for s in plane.strips]
    coils = [CoilSpring(c.hubs, (c.stiffness[0] / 2, c.stiffness[1] / 2), c.damping / 2) for c in plane.coils]
    face = FaceParts(strips, coils, np.array([one.friction for one in plane.hubs]))
    stiffness = ConnectorStiffness(2.0, 3e4)
    return Biplane(plane, face, face, discs, apart, OUTSIDE, stiffness, lateral, 25.0)


def lifted(model: Biplane) -> BiplaneMotion:
    """Its motion, high above the table."""
    motion = BiplaneMotion(model, FREE)
    joints = [motion.model.joint(i) for i in range(motion.model.njnt)]
    for joint in joints:
        if joint.name.endswith("_z") and not (joint.name.endswith("back_z") and motion.model.neq):
            motion.data.qpos[joint.qposadr[0]] = 1.0
    return motion


def rest(motion: BiplaneMotion, seconds: float, length: float = FREE[0]) -> np.ndarray:
    """Middles of the hubs after a time with all coils at one free length, shape (M, 3)."""
    motion.follow(np.full((round(seconds / 0.05) + 1, motion.model.nu), length), 0.05)
    return motion.discs.mean(axis=1)


def ladder(apart: float, max_rotation: float = np.radians(5), lateral: float = 0.1) -> Biplane:
    """A light hub on the strips of a heavy one."""
    hubs: Sequence[Hub] = [hub(0.0, 1.0, mass=1e3, inertia=1e3), hub(LENGTH + 2 * SOCKET, 1.0)]
    plane = small(
        hubs, [strip()], socket=SOCKET, corner=1e-3, max_rotation=max_rotation, drag=20.0
    )  # fmt: skip
    return biplane(plane, lateral=lateral, apart=apart)


def triangle(**changes: object) -> Multibody:
    """Three equal hubs, two of which stand."""
    pitch = LENGTH + 2 * SOCKET
    places = [(0.0, 0.0), (pitch, 0.0), (pitch / 2, pitch * np.sqrt(0.75))]
    strips = [replace(strip(), hubs=ends) for ends in ((0, 1), (0, 2), (1, 2))]
    values = {"gravity": -9.81, "socket": SOCKET, "corner": 7e-3, "max_rotation": 0.01, **changes}
    return small([hub(x, y, inertia=1.2e-7) for x, y in places], strips, **values)


def test_a_ladder_twists_until_its_sockets_hold_and_then_bends_its_strips() -> None:
    """A couple T about the ladder: each strip carries T / 2s across it, half of the moment in each socket."""
    apart, beyond = 0.1, np.radians(2)
    turn = np.radians(5) + beyond
    couple = 2 * apart * 6 * HALF_BENDING * beyond / LENGTH
    motion = lifted(ladder(apart))
    motion.data.xfrc_applied[2, 3] = couple
    rest(motion, 2.0)
    across = motion.data.xmat[2].reshape(3, 3)[:, 1]
    assert np.arcsin(across[2]) == pytest.approx(np.arcsin(LENGTH * np.sin(turn) / apart), rel=0.02)


def test_a_ladder_sways_by_its_play_and_then_bends_its_strips_on_edge() -> None:
    beyond = np.radians(0.5)
    motion = lifted(ladder(APART))
    motion.data.xfrc_applied[2, 1] = 2 * 6 * 25 * HALF_BENDING * beyond / LENGTH
    found = rest(motion, 2.0)
    sway = LENGTH * np.sin(0.1 + beyond)
    assert found[1, 1] - found[0, 1] == pytest.approx(sway, rel=0.01)
    still = lifted(ladder(APART, lateral=0.0))
    still.data.xfrc_applied[2, 1] = 0.1
    assert abs(rest(still, 1.0)[1, 1]) < 2e-4


def test_a_connector_twists_and_shears_as_stiffly_as_it_is() -> None:
    plane = small([hub(0.0, 1.0, mass=2e-3)], socket=SOCKET, corner=1e-3, max_rotation=0.2, drag=20.0)
    one = biplane(plane, "yielding")
    heavy = Inertia(1e3, one.discs[0].front.centre, 1e3 * np.eye(3))
    motion = lifted(replace(one, discs=[replace(one.discs[0], front=heavy)]))
    motion.data.xfrc_applied[2] = [3.0, 0.0, -2.0, 0.0, 0.004, 0.0]
    rest(motion, 0.3)
    found = [float(motion.data.joint(f"hub_00_back_{name}").qpos[0]) for name in ("x", "z", "turn")]
    assert found == pytest.approx([3.0 / 3e4, -2.0 / 3e4, -0.004 / 2.0], rel=1e-3)


def test_the_stiffness_of_connectors_is_that_of_a_round_bar() -> None:
    """By an integral over the bar: 35 mm long, 6 mm thick; shear modulus of 1600 MPa and 0.35."""
    found, shear = connector_stiffness(SPEC, PRINTER), 1600e6 / 2.7
    r = (np.arange(100_000) + 0.5) * 3e-3 / 100_000
    polar = float((2 * np.pi * r**3).sum() * 3e-3 / 100_000)
    assert found.twist == pytest.approx(shear * polar / 0.035, rel=1e-6)
    s = (np.arange(1000) + 0.5) * 0.035 / 1000
    moment = 0.035 / 2 - s  # for a force of 1 N: the ends stay parallel
    bent = (moment**2).sum() * 0.035 / 1000 / (2100e6 * polar / 2)
    assert 1 / found.shear == pytest.approx(bent + 0.035 / (0.9 * shear * np.pi * 9e-6), rel=1e-4)
    # A slot of 5.3 mm, a strip of 5.0 mm, held over 3.25 mm.
    assert lateral_rotation(SPEC) == pytest.approx(np.arctan(0.3 / 3.25))


@pytest.mark.parametrize("beyond", [-1.5, 1.5])
def test_a_standing_body_tips_where_its_mass_passes_its_outer_feet(beyond: float) -> None:
    """Of three hubs: their middle is 7 mm and a third of the triangle's height above the table."""
    plane = triangle()
    height = 7e-3 + float(np.mean([one.position[1] for one in plane.hubs]))
    plane = replace(plane, hubs=[replace(one, friction=5.0) for one in plane.hubs])
    tilt = np.arctan(OUTSIDE / height) + np.radians(beyond)
    motion = BiplaneMotion(replace(biplane(plane, lateral=0.0), side_tilt=tilt), FREE)
    rest(motion, 0.3)
    leans = abs(np.degrees(np.arcsin(motion.data.xmat[1].reshape(3, 3)[2, 1])))
    assert leans < 0.5 if beyond < 0 else leans > 20


@pytest.mark.parametrize("part", [0.9, 1.3])
def test_a_moment_turns_a_standing_body_against_coulombs_friction(part: float) -> None:
    """Four feet with a quarter of the weight each, at one distance: they slide from mu W r on."""
    plane = triangle()
    motion = BiplaneMotion(biplane(plane, lateral=0.0), FREE)
    places = motion.discs.mean(axis=1)[:, :2]
    places -= places[:2].mean(axis=0)
    rest(motion, 0.1)
    weight, reach = 15e-3 * 9.81, np.hypot(places[1, 0], OUTSIDE)
    motion.data.xfrc_applied[1:, 5] = part * 0.5 * weight * reach / 3
    inertia = sum(
        one.inertia.tensor[2, 2] + one.inertia.mass * (at @ at + APART**2)
        for one, at in zip(plane.hubs, places, strict=True)
    )
    before = motion.discs.mean(axis=1)
    seconds = 0.3
    after = rest(motion, seconds)
    first, last = (x[1, :2] - x[0, :2] for x in (before, after))
    turned = np.arctan2(last[1], last[0]) - np.arctan2(first[1], first[0])
    if part < 1:
        assert abs(turned) < 5e-3, "what connectors and sockets yield"
    else:
        expected = (part - 1) * 0.5 * weight * reach / inertia * seconds**2 / 2
        assert turned == pytest.approx(expected, rel=0.15), "of the difference of moment and friction"


def test_a_body_slides_sideways_beyond_the_angle_of_friction() -> None:
    for slope, moves in ((0.45, False), (0.55, True)):
        motion = BiplaneMotion(
            replace(biplane(triangle(), lateral=0.0), side_tilt=float(np.arctan(slope))), FREE
        )
        slid = rest(motion, 0.4)[:2, 1]
        down = 9.81 * (np.sin(np.arctan(slope)) - 0.5 * np.cos(np.arctan(slope))) * 0.4**2 / 2
        assert slid == pytest.approx([down if moves else 0.0] * 2, rel=0.1, abs=2e-4)


@pytest.mark.parametrize("joining", ["rigid", "yielding", "apart"])
def test_momenta_are_kept_in_space(joining: Joining) -> None:
    plane = triangle(gravity=0.0, max_rotation=0.3)
    motion = lifted(biplane(plane, joining))
    motion.data.qvel[:] = np.random.default_rng(1).normal(0.0, 0.02, motion.model.nv)
    model, data, found = motion.model, motion.data, []
    for _ in range(2):
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        linear = model.body_subtreemass[0] * data.subtree_linvel[0]
        found.append(np.array([*linear, *data.subtree_angmom[0]]))
        rest(motion, 0.2)
    assert found[1][:3] == pytest.approx(found[0][:3], rel=0.005)
    assert found[1][3:] == pytest.approx(found[0][3:], rel=0.01)


def test_the_compiled_model_is_the_one_that_was_meant() -> None:
    """Strips, sockets and connectors yield with their stiffness by MuJoCo's own inverse weights, also where a
    hub with six springs has no connector."""
    mask = np.ones((2, 3), bool)
    lattice = Lattice(2, 3)
    passive = develop(lattice, Genotype(mask, np.zeros(len(lattice.springs), bool)))
    for body in (passive, TINY):
        model = with_yielding_connectors(build_biplane(body, SPEC, PRINTER))
        found = BiplaneMotion(model, FREE).model
        assert found.body_mass.sum() == pytest.approx(sum(h.inertia.mass for h in robot(body).hubs))
        limited = np.flatnonzero(found.tendon_limited)
        time, impedance = found.tendon_solref_lim[limited, 0], found.tendon_solimp_lim[limited, 0]
        yields = 1 / ((1 - impedance) * time**2 * found.tendon_invweight0[limited])
        names = [found.tendon(int(i)).name for i in limited]
        along = [y for y, name in zip(yields, names, strict=True) if name.count("_") == 2]
        assert along == pytest.approx([BuiltParameters().tension] * len(along), rel=1e-6)
        bends = {
            k: [y for y, n in zip(yields, names, strict=True) if n.endswith(k)] for k in ("turn", "lateral")
        }
        for kind, bending, angle in (
            ("turn", HALF_BENDING, np.radians(15)), ("lateral", 25 * HALF_BENDING, lateral_rotation(SPEC))
        ):  # fmt: skip
            expected = 3 * bending / (LENGTH * np.cos(angle)) ** 2
            assert bends[kind] == pytest.approx([expected] * len(bends[kind]), rel=3e-3)
        dofs = found.jnt_dofadr[found.eq_obj1id]
        held = 1 / ((1 - found.eq_solimp[:, 0]) * found.eq_solref[:, 0] ** 2 * found.dof_invweight0[dofs])
        part = model.connector
        assert held == pytest.approx([part.shear, part.shear, part.twist] * (found.neq // 3), rel=1e-6)
        joined = [pair.joining for pair in model.discs]
        assert found.neq == 3 * joined.count("yielding")
    assert biplane_mjcf(model) == biplane_mjcf(with_yielding_connectors(build_biplane(TINY, SPEC, PRINTER)))


def test_faces_that_are_alike_walk_as_in_the_plane() -> None:
    t = np.arange(81)[:, None] * 0.05
    heated = (1 - np.cos(2 * np.pi * t / 4 - 0.5 * np.pi * np.arange(TINY.motors))) / 4 * np.minimum(t, 1)
    lengths = FREE[0] + (FREE[1] - FREE[0]) * heated
    flat = MujocoMotion(robot(TINY), FREE)
    ours = BiplaneMotion(with_lateral_rotation(build_biplane(TINY, SPEC, PRINTER), 0.0), FREE)
    start = flat.positions
    flat.follow(lengths, 0.05)
    ours.follow(np.repeat(lengths, 2, axis=1), 0.05)
    moved = (flat.positions - start)[:, 0].mean() / np.ptp(start[:, 0])
    found = (ours.positions - start)[:, 0].mean() / np.ptp(start[:, 0])
    assert abs(moved) > 0.02 and found == pytest.approx(moved, abs=0.01)
    assert np.ptp(ours.discs[..., 1], axis=0).max() < 1e-5, "it stays in its plane"


def test_one_face_that_is_longer_turns_the_robot() -> None:
    """Coils of the front face that extend by 4 mm more: hubs lean, alike with the faces changed."""
    leans = []
    for front, back in ((0.044, 0.040), (0.040, 0.044)):
        motion = BiplaneMotion(build_biplane(TINY, SPEC, PRINTER), FREE)
        motion.follow(np.tile([front, back], (11, TINY.motors)), 0.05)
        leans.append(motion.discs[:, 0] - motion.discs[:, 1])
    mirrored = leans[1] * [-1.0, 1.0, -1.0]
    assert np.abs(leans[0][:, 0]).max() > 2e-4
    assert leans[0] == pytest.approx(mirrored, abs=2e-4)


def test_the_seed_gives_the_front_face_of_the_planar_robot() -> None:
    body = TINY
    flat, ours, other = sample_multibody(body, 5), sample_biplane(body, 5), sample_biplane(body, 6)
    assert [s.length for s in ours.front.strips] == pytest.approx([s.length for s in flat.strips], abs=1e-12)
    assert ours.front.friction == pytest.approx([h.friction for h in flat.hubs])
    assert ours.plane.tilt == flat.tilt and ours.plane.parameters == flat.parameters
    both = [[s.length for s in face.strips] for face in ours.faces]
    assert np.std(np.subtract(*both)) == pytest.approx(0.3e-3 * np.sqrt(2), rel=0.5)
    assert 0.05 < np.std(np.log(ours.back.friction)) < 0.2 and ours.side_tilt not in (0.0, other.side_tilt)
    heavy = sample_biplane(body, 5, ballast=np.eye(len(body.positions))[3] * 8e-3)
    more = [getattr(heavy.discs[3], f).mass - getattr(ours.discs[3], f).mass for f in FACES]
    assert more == pytest.approx([4e-3, 4e-3])


def test_feet_grip_more_backward_whichever_way_the_robot_looks() -> None:
    grips = BuiltParameters(backward_friction=2.5).with_hubs()
    model = build_biplane(TINY, SPEC, PRINTER, grips)
    for yaw in (0.0, np.pi / 2, 2.5):
        motion = BiplaneMotion(model, FREE)
        ahead = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        count = len(model.discs)
        for i, pair in enumerate(model.plane.hubs):
            joints = motion.data.qpos.reshape(count, 6)
            joints[i, 3] = yaw
            joints[i, :3] = ahead * pair.position[0] - [pair.position[0], 0.0, 0.0]
        speeds = np.where(np.arange(count) % 2, 0.05, -0.05)
        motion.data.qvel.reshape(count, 6)[:, :3] = speeds[:, None] * ahead
        mujoco.mj_forward(motion.model, motion.data)
        before = motion.model.geom_friction[:, 0].copy()
        motion.follow(np.full((2, motion.model.nu), FREE[0]), motion.model.opt.timestep)
        feet = [[motion.model.geom(f"hub_{i:02d}_{f}_foot").id for f in FACES] for i in range(count)]
        ratio = motion.model.geom_friction[np.array(feet), 0] / before[np.array(feet)]
        assert ratio == pytest.approx(np.where(speeds < 0, 2.5, 1.0)[:, None] * np.ones(2))


def test_a_robot_stands_on_a_terrain_as_in_the_plane() -> None:
    ground = Terrain.from_segments(np.array([-1.0]), np.array([0.1]), np.array([0.0]))
    flat = MujocoMotion(robot(TINY, terrain=ground), FREE)
    ours = BiplaneMotion(build_biplane(TINY, SPEC, PRINTER, terrain=ground), FREE)
    flat.follow(np.full((11, TINY.motors), FREE[0]), 0.05)
    rest(ours, 0.5)
    assert np.abs(ours.positions - flat.positions).max() < 5e-4
