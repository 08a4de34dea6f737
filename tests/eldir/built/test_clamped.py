"""Strips clamped in hexagons that turn: closed forms and conservation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eldir.built.motion import drive
from eldir.built.robot import PrintedRobot, build, rest_state
from eldir.built.stability import stable_step
from eldir.parameters.printed import BuiltParameters
from tests.eldir.built.braced_robots import FREE_FALL, bodies, momenta, strip, swing, unheated

CLAMPED = BuiltParameters.clamped()
FLOATING = replace(FREE_FALL, bending=CLAMPED.bending)


def energy(robot: PrintedRobot, state: np.ndarray) -> float:
    """Kinetic energy, and that of strips below their buckling load [J]."""
    x, v, angle, spin = state[:2].T, state[2:4].T, np.arctan2(state[5], state[4]), state[6]
    a, b = robot.springs.T
    d, rest = x[a] - x[b], robot.positions[a] - robot.positions[b]
    stretch = np.linalg.norm(d, axis=1) - robot.rest_lengths
    chord = np.arctan2(d[:, 1], d[:, 0]) - np.arctan2(rest[:, 1], rest[:, 0])
    pa, pb = ((angle[i] - chord + np.pi) % (2 * np.pi) - np.pi for i in (a, b))
    bending = robot.bending @ (2 * pa**2 + 2 * pa * pb + 2 * pb**2)
    moving = robot.masses @ (v**2).sum(axis=1) / 2 + robot.inertias @ spin**2 / 2
    return float(moving + robot.stiffness @ stretch**2 / 2 + bending)


def floating(seed: int = 0) -> tuple[PrintedRobot, np.ndarray]:
    """A body without motors, high up, that has been shaken."""
    body, rng = bodies(1, 3)[0], np.random.default_rng(seed)
    inactive = replace(body, active=np.zeros(len(body.springs), bool))
    robot = build(inactive, FLOATING)
    state = rest_state(robot)
    state[1] += 5.0
    state[2:4] = 0.05 * rng.standard_normal((2, len(robot.masses)))
    state[6] = 10.0 * rng.standard_normal(len(robot.masses))
    return robot, state


def test_momenta_are_kept() -> None:
    robot, state = floating()
    (motion,) = drive([robot], [unheated(robot, 51)], 0.01, states=[state])
    before, after = momenta(robot, state), momenta(robot, motion.state)
    assert np.abs(motion.state[5]).max() > 0.05  # hexagons have turned
    assert np.abs(after - before).max() < 1e-9 * np.abs(robot.masses @ np.abs(state[2]))
    assert np.abs(np.hypot(motion.state[4], motion.state[5]) - 1).max() < 1e-12


def test_energy_is_kept_better_with_smaller_steps() -> None:
    robot, state = floating()
    lost = []
    for part in (0.4, 0.1):
        step = part * stable_step(robot)
        (motion,) = drive([robot], [unheated(robot, 21)], 0.005, states=[state], step=step)
        lost.append(abs(energy(robot, motion.state) / energy(robot, state) - 1))
    assert lost[1] < 0.01 and lost[1] < 0.5 * lost[0]


def test_damping_only_takes_energy() -> None:
    robot, state = floating()
    still = replace(CLAMPED, gravity=-1e-12, drag=0.0, buckling=1e9)
    damped = build_like(robot, still)
    energies, at = [energy(damped, state)], state
    for _ in range(10):
        (motion,) = drive([damped], [unheated(damped, 2)], 0.01, states=[at])
        at = motion.state
        energies.append(energy(damped, at))
    assert (np.diff(energies) < 0).all() and energies[-1] < 0.9 * energies[0]
    assert np.abs(momenta(damped, at) - momenta(damped, state)).max() < 1e-9


def build_like(robot: PrintedRobot, p: BuiltParameters) -> PrintedRobot:
    """The same body with other parameters and the dashpots that belong to them."""
    a, b = robot.springs.T
    reduced = robot.masses[a] * robot.masses[b] / (robot.masses[a] + robot.masses[b])
    return replace(robot, parameters=p, damping=2 * p.strip_damping * np.sqrt(p.tension * reduced))


@pytest.mark.parametrize("angle", [0.3, -1.5, 3.0, 12.0])
def test_turning_a_body_rigidly_gives_no_force(angle: float) -> None:
    robot, state = floating()
    c, s = np.cos(angle), np.sin(angle)
    state[2:4], state[6] = 0.0, 0.0
    middle = state[:2].mean(axis=1, keepdims=True)
    state[:2] = np.array([[c, -s], [s, c]]) @ (state[:2] - middle) + middle
    state[4], state[5] = c, s
    (motion,) = drive([robot], [unheated(robot, 11)], 0.01, states=[state])
    assert np.abs(motion.positions - state[:2].T).max() < 1e-11
    assert np.abs(motion.state[6]).max() < 1e-5  # lengths are off by 1e-12 m: the engine's softening


@pytest.mark.parametrize("slope", [0.3, 1.0, -2.0])
def test_a_cantilever_sags_as_the_closed_form_says(slope: float) -> None:
    """W cos(slope) l^3 / (3 E I), on a hexagon too heavy to turn."""
    p = replace(CLAMPED, drag=20.0, gravity=-0.981)  # little: the closed form is for small slopes
    length, weight = 0.05, 2e-3 * 0.981
    out = np.array([np.cos(slope), abs(np.sin(slope))])
    robot = strip((0.0, 0.0), tuple(length * out), (1e6, 2e-3), p)
    (motion,) = drive([robot], [unheated(robot, 151)], 0.01, every=150)
    across = np.array([-out[1], out[0]])
    sag = -(motion.positions[-1] - robot.positions)[1] @ across
    assert sag == pytest.approx(weight * out[0] * length**2 / (3 * p.bending), rel=0.003)


def test_hexagons_on_a_bent_strip_swing_with_the_strips_damping_ratio() -> None:
    """Two bare hexagons kept from turning by their inertia: stiffness 12 E I / l^3 across the strip."""
    p = replace(FLOATING, strip_damping=0.05, gyration=10.0)
    robot = strip((0.0, 5.0), (p.pitch, 5.0), (p.hexagon, p.hexagon), p)
    state = rest_state(robot)
    state[1] += [1e-5, -1e-5]
    (motion,) = drive([robot], [unheated(robot, 401)], 1e-4, states=[state])
    off = np.diff(motion.positions[:, :, 1], axis=1)[:, 0]
    omega = np.sqrt(12 * p.bending / p.pitch**2 / (p.hexagon / 2))
    ratio, t = 0.05, motion.times
    damped = omega * np.sqrt(1 - ratio**2)
    closed = np.exp(-ratio * omega * t) * (np.cos(damped * t) + ratio * omega / damped * np.sin(damped * t))
    assert np.abs(off / -2e-5 - closed).max() < 0.02


def test_going_on_equals_one_long_run() -> None:
    robots = [build(m, CLAMPED) for m in bodies(2)]
    tables = [swing(r, 41) for r in robots]
    whole = drive(robots, tables, 0.01)
    first = drive(robots, [t[:21] for t in tables], 0.01)
    second = drive(robots, [t[20:] for t in tables], 0.01, states=[m.state for m in first])
    for w, s in zip(whole, second, strict=True):
        assert w.positions[20:].tobytes() == s.positions.tobytes() and w.state.tobytes() == s.state.tobytes()


def test_strips_without_bending_stiffness_are_pinned() -> None:
    body = bodies(1)[0]
    pinned, hardly = build(body), build(body, BuiltParameters(bending=1e-20))
    table = swing(pinned, 21)
    step = 0.8 * stable_step(pinned)
    one, other = drive([pinned, hardly], [table, table], 0.01, step=step)
    assert np.ptp(one.positions, axis=0).max() > 1e-3
    assert np.abs(one.positions - other.positions).max() < 1e-7
