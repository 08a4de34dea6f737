"""Small robots for printing whose motion is known: random ones, braced ones, and strips."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from eldir.built.robot import PrintedRobot
from eldir.genotype import Genotype, random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters
from tests.eldir.engine.hub_twin import least_bent

LATTICE = Lattice(6, 11)
COLD, HOT = SpringParameters.cold_length, SpringParameters.hot_length
FREE_FALL = BuiltParameters(gravity=-1e-12, drag=0.0, strip_damping=0.0, active_damping=0.0, buckling=1e9)


def bodies(n: int, seed: int = 2) -> list[Morphology]:
    return [develop(LATTICE, g) for g in random_genotypes(LATTICE, n, np.random.default_rng(seed), 2)]


def body(*cells: tuple[int, int]) -> Morphology:
    """The body of some triangles (row, column); its first two springs are active."""
    mask = np.zeros((LATTICE.rows, LATTICE.columns), bool)
    for row, column in cells:
        mask[row, column] = True
    springs = np.zeros(len(LATTICE.springs), bool)
    springs[np.flatnonzero(LATTICE.expressed_springs(mask))[:2]] = True
    return develop(LATTICE, Genotype(mask, springs))


def braced() -> Morphology:
    """A broad body with one motor, which its neighbours hold."""
    design = body(*[(0, c) for c in range(1, 8)], *[(1, c) for c in range(2, 7)])
    beside = [np.isin(design.springs, ends).any(axis=1).sum() for ends in design.springs]
    return replace(design, active=np.arange(len(design.springs)) == int(np.argmax(beside)))


def strip(
    a: tuple[float, float], b: tuple[float, float], masses: tuple[float, float], p: BuiltParameters
) -> PrintedRobot:
    """Two masses and a strip between them, without stress as given."""
    at, m = np.array([a, b]), np.array(masses)
    reduced = m.prod() / m.sum()
    return PrintedRobot(
        at, np.array([[0, 1]], np.int32), np.zeros(1, bool), m, np.array([np.linalg.norm(at[0] - at[1])]),
        np.array([p.tension]), np.array([p.buckling]),
        np.array([2 * p.strip_damping * np.sqrt(p.tension * reduced)]), np.ones(2), p,
    )  # fmt: skip


def unheated(robot: PrintedRobot, instants: int) -> np.ndarray:
    return np.full((instants, int(robot.active.sum())), COLD)


def swing(robot: PrintedRobot, instants: int, period: float = 0.4, interval: float = 0.01) -> np.ndarray:
    """Free lengths that go from cold to hot and back, each motor a quarter period after the other."""
    t = np.arange(instants)[:, None] * interval / period - 0.25 * np.arange(int(robot.active.sum()))
    return COLD + (HOT - COLD) * 0.5 * (1 - np.cos(2 * np.pi * np.maximum(t, 0)))


def momenta(robot: PrintedRobot, state: np.ndarray) -> np.ndarray:
    """Linear in x and y, and angular about the origin."""
    x, y, vx, vy, _, _, spin = state
    m = robot.masses
    return np.array([m @ vx, m @ vy, m @ (x * vy - y * vx) + robot.inertias @ spin])


def energy(robot: PrintedRobot, state: np.ndarray) -> float:
    """Kinetic energy, and that of strips below their buckling load [J]; without friction in the sockets."""
    p, angle = robot.parameters, np.arctan2(state[5], state[4])
    total = robot.masses @ (state[2:4] ** 2).sum(axis=0) / 2 + robot.inertias @ state[6] ** 2 / 2
    for s, (a, b) in enumerate(robot.springs):
        way = np.arctan2(*robot.directions[s][::-1])
        out = [np.array([np.cos(way + angle[i]), np.sin(way + angle[i])]) for i in (a, b)]
        d = state[:2, a] - state[:2, b] - p.socket * (out[0] + out[1])
        chord = np.arctan2(d[1], d[0])
        turned = np.array([(way + angle[i] - chord + np.pi) % (2 * np.pi) - np.pi for i in (a, b)])
        pa, pb = least_bent(turned, p.socket_turn)
        total += 2 * robot.bending[s] * (pa**2 + pa * pb + pb**2)
        total += robot.stiffness[s] * (np.linalg.norm(d) - robot.rest_lengths[s] + 2 * p.socket) ** 2 / 2
    return float(total)
