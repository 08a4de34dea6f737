"""Hubs with sockets and corners: closed forms, conservation, and a twin that computes with matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eldir.built.motion import drive
from eldir.built.robot import PrintedRobot, build, rest_state
from eldir.built.stability import STICKS, stable_step
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir_cad.checks.strip_law import StripLaw, hub_parameters
from eldir_cad.geometry.assembly import assemble
from eldir_cad.kit import PRINTER
from eldir_cad.kit.printer import load_printer
from eldir_cad.kit.specification import load_specification
from eldir_cad.multibody.hubs import hub_inertias
from eldir_cad.multibody.model import SOCKET_FRICTION
from tests.eldir.built.braced_robots import (
    COLD,
    FREE_FALL,
    HOT,
    bodies,
    energy,
    momenta,
    strip,
    swing,
    unheated,
)
from tests.eldir.engine.hub_twin import least_bent
from tests.eldir.engine.twin import built_run
from tests.raised import raises

HUBS = BuiltParameters().with_hubs()
STANDING = replace(HUBS, corner=0.0, drag=20.0, gravity=-0.981)  # on a point it does not topple
PRINTED = load_specification(), load_printer(PRINTER)


def floating(spin: float = 3.0, **changes: float) -> tuple[PrintedRobot, np.ndarray]:
    """A body without motors, high up, that has been shaken."""
    body, rng = bodies(1, 3)[0], np.random.default_rng(0)
    inactive = replace(body, active=np.zeros(len(body.springs), bool))
    hubs = {name: getattr(HUBS, name) for name in ("bending", "socket", "corner", "gyration")}
    robot = build(inactive, replace(FREE_FALL, **hubs, socket_turn=0.03, **changes))
    state = rest_state(robot)
    state[1] += 5.0
    state[2:4] = 0.05 * rng.standard_normal((2, len(robot.masses)))
    state[6] = spin * rng.standard_normal(len(robot.masses))
    return robot, state


def test_the_numbers_are_those_of_the_parts() -> None:
    spec, printer = PRINTED
    law, own = StripLaw.of(spec, printer), hub_parameters(spec, printer)
    assert own == HUBS
    assert pytest.approx(1e-3 * spec.bulb_radius_at) == HUBS.socket
    assert pytest.approx(5e-4 * spec.mass.across_corners, rel=1e-3) == HUBS.corner
    assert pytest.approx(np.radians(spec.strip.turn_deg)) == HUBS.socket_turn
    assert pytest.approx(1e-3 * law.flexural_rigidity / law.length, rel=5e-3) == HUBS.bending
    assert pytest.approx(SOCKET_FRICTION / 2) == HUBS.socket_friction  # of one face


def test_hubs_turn_as_their_meshes_say() -> None:
    body = bodies(1)[0]
    plane = build(body, HUBS)
    meshes = hub_inertias(assemble(body, PRINTED[0]), *PRINTED[:1], PRINTED[1].material.density,
                          BuiltParameters(), BuiltParameters(), np.zeros(len(plane.masses)))  # fmt: skip
    about_centre = [h.tensor[1, 1] + h.mass * (h.centre[[0, 2]] ** 2).sum() for h in meshes]
    assert np.median(plane.inertias * 2 / about_centre) == pytest.approx(1, abs=0.1)


def test_momenta_are_kept() -> None:
    robot, state = floating(socket_friction=1e-3)
    (motion,) = drive([robot], [unheated(robot, 51)], 0.01, states=[state])
    before, after = momenta(robot, state), momenta(robot, motion.state)
    assert np.abs(motion.state[5]).max() > 0.05  # hubs have turned
    assert np.abs(after - before).max() < 1e-9 * np.abs(robot.masses @ np.abs(state[2]))
    assert np.abs(np.hypot(motion.state[4], motion.state[5]) - 1).max() < 1e-9


def test_energy_is_kept_better_with_smaller_steps() -> None:
    robot, state = floating()
    lost = []
    for part in (0.4, 0.1):
        step = part * stable_step(robot)
        (motion,) = drive([robot], [unheated(robot, 21)], 0.005, states=[state], step=step)
        lost.append(abs(energy(robot, motion.state) / energy(robot, state) - 1))
    assert lost[1] < 0.01 and lost[1] < 0.6 * lost[0]


def test_damping_and_friction_only_take_energy() -> None:
    for changes in ({"strip_damping": 0.2}, {"socket_friction": 1e-3}):
        robot, state = floating(10.0, **changes)
        energies, at = [energy(robot, state)], state
        for _ in range(10):
            (motion,) = drive([robot], [unheated(robot, 2)], 0.01, states=[at])
            at = motion.state
            energies.append(energy(robot, at))
        assert energies[-1] < 0.9 * energies[0] and max(energies) < 1.001 * energies[0]


@pytest.mark.parametrize("angle", [0.3, -1.5, 3.0, 12.0])
def test_turning_a_body_rigidly_gives_no_force(angle: float) -> None:
    robot, state = floating(socket_friction=1e-3)
    c, s = np.cos(angle), np.sin(angle)
    state[2:4], state[6] = 0.0, 0.0
    middle = state[:2].mean(axis=1, keepdims=True)
    state[:2] = np.array([[c, -s], [s, c]]) @ (state[:2] - middle) + middle
    state[4], state[5] = c, s
    (motion,) = drive([robot], [unheated(robot, 11)], 0.01, states=[state])
    assert np.abs(motion.positions - state[:2].T).max() < 1e-10
    assert np.abs(motion.state[6]).max() < 1e-4


def inclined(slope: float, p: BuiltParameters) -> tuple[PrintedRobot, np.ndarray, np.ndarray]:
    """A strip that rises from a hub too heavy to turn, to one of 20 g: where it comes to rest, from its first
    hinge to the second and to the centre of the second hub, shape (2, 2); and the angles of its ends from its
    chord [rad], shape (2,)."""
    out = np.array([np.cos(slope), np.sin(slope)])
    robot = strip((0.0, 0.0), tuple(p.pitch * out), (1e6, 0.02), p)
    (motion,) = drive([robot], [unheated(robot, 601)], 0.01, every=600)
    angle = np.arctan2(motion.state[5], motion.state[4])
    hinge = p.socket * out
    other = motion.positions[-1, 1] - p.socket * np.array(
        [np.cos(slope + angle[1]), np.sin(slope + angle[1])]
    )
    chord = np.arctan2(*(other - hinge)[::-1])
    return robot, np.array([other, motion.positions[-1, 1]]) - hinge, slope + angle - chord


@pytest.mark.parametrize("turn", [5.0, 15.0])
def test_a_strip_hangs_in_its_socket_and_bends_beyond(turn: float) -> None:
    """The weight's moment about each hinge is that of a beam whose ends have the least energy."""
    p = replace(STANDING, socket_turn=np.radians(turn), socket_friction=0.0)
    robot, (hinge, centre), turned = inclined(1.0, p)
    weight = robot.masses[1] * 0.981
    wanted = weight * np.array([centre[0], centre[0] - hinge[0]])
    pa, pb = least_bent(turned, p.socket_turn)
    ends = p.bending * np.array([4 * pa + 2 * pb, 2 * pa + 4 * pb])
    assert turned[0] > np.radians(turn) + 0.01
    assert ends[0] == pytest.approx(wanted[0], rel=0.01)
    assert ends[1] == pytest.approx(-wanted[1], abs=0.01 * wanted[0])


@pytest.mark.parametrize(("share", "turns"), [(0.5, False), (2.0, True)])
def test_friction_holds_a_strip_in_its_socket(share: float, turns: bool) -> None:
    moment = 0.02 * 0.981 * (HUBS.pitch - HUBS.socket) * np.cos(0.5)
    p = replace(STANDING, socket_friction=moment / share)
    turned = inclined(0.5, p)[2]
    assert (turned[0] > np.radians(14)) == turns
    assert (turned[0] < STICKS) != turns


def loose(p: BuiltParameters) -> PrintedRobot:
    """Two hubs of 2 g, and between them a strip that hardly holds anything."""
    p = replace(p, tension=1e-6, buckling=1e-9, bending=1e-15, socket_friction=0.0)
    return strip((0.0, 0.0), (p.pitch, 0.0), (2e-3, 2e-3), p)


def test_a_hub_falls_from_its_corner() -> None:
    """A physical pendulum upside down on a rough table: I theta'' = m g R sin(theta)."""
    p = replace(HUBS, drag=0.0, friction=5.0)
    robot = loose(p)
    state = rest_state(robot)
    tilt = 1e-3
    state[4], state[5] = np.cos(tilt), np.sin(tilt)
    state[1] = p.corner * (np.cos(tilt) - 1)
    rate = np.sqrt(-p.gravity * p.corner / (p.gyration**2 + p.corner**2))
    (motion,) = drive([robot], [unheated(robot, 11)], 0.01, states=[state], step=1e-5)
    found = np.arctan2(motion.state[5], motion.state[4])[0]
    assert found == pytest.approx(tilt * np.cosh(rate * 0.1), rel=0.01)
    # The corner has not slipped: the centre has moved by R (sin theta - sin tilt) to the other side.
    assert motion.positions[-1, 0, 0] == pytest.approx(-p.corner * (np.sin(found) - np.sin(tilt)), rel=0.01)


def test_a_hub_that_cannot_turn_slides_as_a_block() -> None:
    """v^2 / (2 mu g), and it stops."""
    p = replace(HUBS, drag=0.0, gyration=1e3)
    robot = loose(p)
    state = rest_state(robot)
    state[2] = 0.3
    (motion,) = drive([robot], [unheated(robot, 21)], 0.01, states=[state], step=1e-5)
    assert motion.positions[-1, 0, 0] == pytest.approx(0.3**2 / (2 * 0.5 * 9.81), rel=1e-3)
    assert abs(motion.state[2, 0]) < 1e-9


def test_a_hub_comes_to_rest_on_two_corners() -> None:
    p = replace(HUBS, drag=20.0)
    robot = loose(p)
    state = rest_state(robot)
    state[4], state[5] = np.cos(0.2), np.sin(0.2)
    (motion,) = drive([robot], [unheated(robot, 201)], 0.01, every=200, states=[state], step=2e-5)
    angle = np.arctan2(motion.state[5], motion.state[4])[0]
    assert angle == pytest.approx(np.radians(30), abs=0.01)
    assert motion.positions[-1, 0, 1] == pytest.approx(p.corner * (np.cos(np.radians(30)) - 1), abs=1e-4)


@pytest.mark.parametrize(
    ("seed", "friction", "tilt"),
    [(2, 1e-4, 0.0), pytest.param(3, 1e-3, 0.0, marks=pytest.mark.stress), (4, 1e-3, 0.1)],
)
def test_twin_moves_the_same(seed: int, friction: float, tilt: float) -> None:
    robot = build(
        bodies(1, seed)[0],
        replace(HUBS, socket_friction=friction, socket_turn=0.03, tilt=tilt, backward_friction=1 + 10 * tilt),
    )
    interval, instants = 0.003, 4
    step = 0.9 * stable_step(robot)
    lengths = COLD + (HOT - COLD) * np.random.default_rng(seed).random((instants, int(robot.active.sum())))
    (motion,) = drive([robot], [lengths], interval, step=step)
    twin = built_run(robot, lengths, interval, int(np.ceil(interval / step)), (COLD, HOT))
    assert np.ptp(motion.positions, axis=0).max() > 1e-4
    assert np.abs(motion.positions - twin).max() < 1e-11


def test_robots_of_all_kinds_move_side_by_side() -> None:
    body = bodies(1)[0]
    kinds = [HUBS, BuiltParameters.clamped(), BuiltParameters(), replace(HUBS, socket_turn=0.05)]
    robots = [build(body, p) for p in kinds]
    tables = [swing(r, 41) for r in robots]
    together = drive(robots, tables, 0.01)
    for robot, table, motion in zip(robots, tables, together, strict=True):
        (alone,) = drive([robot], [table], 0.01)
        assert alone == motion
    assert together[0] != together[3]


def test_sockets_need_strips_that_bend() -> None:
    with raises(InputError, "built-parameters.inconsistent", "BuiltParameters.bending"):
        BuiltParameters(socket=3.7e-3)


def test_clamped_strips_stay_clamped() -> None:
    assert BuiltParameters.clamped().with_hubs() == BuiltParameters.clamped()


def test_random_robots_differ_in_their_sockets() -> None:
    drawn = [HUBS.perturb(np.random.default_rng(seed)) for seed in range(200)]
    frictions = np.log([d.socket_friction / HUBS.socket_friction for d in drawn])
    damping = np.log([d.strip_damping / HUBS.strip_damping for d in drawn])
    assert np.std(frictions) == pytest.approx(0.5, rel=0.2)
    assert np.std(damping) == pytest.approx(0.5, rel=0.2)
    pinned = [BuiltParameters().perturb(np.random.default_rng(seed)) for seed in range(200)]
    assert [p.friction for p in pinned] == [d.friction for d in drawn]  # the same robots otherwise
