"""The engine's arithmetic once more, in NumPy and plain loops, to hold the engine against.

Written from the equations (paper, Sect. Simulation; docs/reference/built.md), one robot and one step
at a time, forward only, float64. A step of the paper's robots is analytic wherever it is smooth: with an
imaginary part of 1e-30 on what it depends on, it carries exact derivatives along (`complex_slopes`).
"""

from __future__ import annotations

from dataclasses import fields
from functools import partial
from types import SimpleNamespace

import numpy as np

from eldir.built.robot import PrintedRobot
from eldir.controller import Controller
from eldir.engine.pack import MotionCotangents
from eldir.morphology import Morphology
from eldir.physics import Physics
from eldir.scene import Scene
from eldir.terrain import Terrain
from tests.eldir.engine.hub_twin import HubStep, down, ground_below


class Ground:
    """Segments of ground: the line that is hit, and the height that nothing goes below."""

    def __init__(self, scene: Scene):
        self.terrain = scene.terrain
        self.broken_left = scene.contact == "friction-released"

    def segment(self, x: float) -> int:
        x = np.real(x)
        if self.broken_left and x < 0:
            return -1
        found = 0
        for i, start in enumerate(self.terrain.x0):
            if x >= start:
                found = i
        return found

    def line(self, i: int) -> tuple[float, float]:
        """Slope and intercept."""
        return (0.0, 0.0) if i < 0 else (self.terrain.slope[i], self.terrain.intercept[i])

    def height(self, x: float) -> float:
        i = self.segment(x)
        return 0.1 if i < 0 else self.terrain.slope[i] * x + self.terrain.intercept[i]

    def normal(self, i: int) -> np.ndarray:
        m, _ = self.line(i)
        return np.array([-m, 1.0]) / np.hypot(1.0, m)


def magnitude(z: np.ndarray) -> complex:
    """Of a number, or the length of a vector, as an analytic function of it."""
    return np.sqrt((z * z).sum()) if np.ndim(z) else (-z if z.real < 0 else z)


def no_slip(x: np.ndarray, w: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """One mass over flat ground at 0.1 m: it stops where it lands."""
    if (x[1] + dt * w[1]).real < 0.1 and w[1].real < -0.025 * dt:
        return x + (0.1 - x[1]) / w[1] * w, 0.0 * w
    return x + dt * w, w


def friction(
    ground: Ground, x: np.ndarray, w: np.ndarray, dt: float, coefficient: float
) -> tuple[np.ndarray, np.ndarray]:
    """One mass over any ground: it hits the nearest line, loses its normal speed and slides on."""
    new = x + dt * w
    if new[1].real >= ground.height(new[0]).real:
        return new, w
    toi = dt
    for i in range(*sorted_range(ground.segment(x[0]), ground.segment(new[0]))):
        m, b = ground.line(i)
        distance = magnitude(x[1] - m * x[0] - b) / np.hypot(1.0, m)
        toi = min(toi, distance / (magnitude(w @ ground.normal(i)) + 1e-10), key=np.real)
    new = x + toi * w
    n = ground.normal(ground.segment(new[0]))
    vn = (w @ n) * n
    vt = w - vn
    speed, lost = magnitude(vt), coefficient * magnitude(vn)
    v = vt - vt / speed * lost if speed.real > lost.real else 0.0 * w
    new = new + (dt - toi) * v
    new[1] = max(new[1], ground.height(new[0]), key=np.real)
    return new, v


def sorted_range(a: int, b: int) -> tuple[int, int]:
    return min(a, b), max(a, b) + 1


def paper_step(
    body: Morphology, brain: Controller, scene: Scene, own: Physics, t: int, x: np.ndarray, v: np.ndarray,
    earlier: np.ndarray, rest: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Positions, velocities (M, 2) and activations (A,) one step after step `t`; `earlier` are the velocities
    of the step before."""
    dt, c = scene.dt, own.damping
    exact = dt if c == 0 else (1 - np.exp(-c * dt)) / c
    falling = dt if scene.integrator == "paper" else exact
    pushing = exact if scene.integrator == "second-order" else dt
    half = 0.5 if scene.integrator == "second-order" else 0.0
    sensed = x - x.mean(axis=0) - (rest if scene.sensing == "centre-and-rest" else 0.0)
    waves = [np.sin(scene.omega * (t + half) * dt + 2 * np.pi * j / 10) for j in range(10)]
    gain = 0.0 if scene.sensing == "none" else 0.05
    inputs = np.concatenate(
        [waves, gain * np.concatenate([sensed, v + half * (v - earlier)], axis=1).ravel()]
    )
    hidden = np.tanh(brain.w1 @ inputs + brain.b1)
    activation = np.tanh(brain.w2 @ hidden + brain.b2)
    impulse = np.zeros_like(x)
    impulse[:, 1] = own.gravity * falling
    motor = 0
    for s, (a, b) in enumerate(body.springs):
        target = own.rest_lengths[s]
        if body.active[s]:
            target = target * (1 + scene.actuation * activation[motor])
            motor += 1
        d = x[a] - x[b]
        length = magnitude(d) + 1e-4
        pull = pushing * own.stiffness[s] * (length - target) / length * d
        impulse[a] -= pull
        impulse[b] += pull
    w = np.exp(-c * dt) * v + impulse
    ground = Ground(scene)
    fly = {"no-slip": lambda x, w: no_slip(x, w, dt), "none": lambda x, w: (x + dt * w, w)}
    move = fly.get(scene.contact, lambda x, w: friction(ground, x, w, dt, own.friction))
    moved = [move(x[i], w[i]) for i in range(len(x))]
    return np.array([m[0] for m in moved]), np.array([m[1] for m in moved]), activation


def paper_rollout(
    body: Morphology, brain: Controller, scene: Scene, physics: Physics | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions and velocities (T + 1, M, 2) and activations (T, A)."""
    own = physics if physics is not None else Physics.of(body, scene)
    start = body.positions.copy()
    start[:, 1] += max(0.0, *(scene.terrain.height(np.array(p[0])) - p[1] for p in start))
    v, rest = own.velocities, start - start.mean(axis=0)
    x = start.astype(v.dtype)
    if scene.integrator == "second-order":
        x = x + scene.dt / 2 * v
    xs, vs, activations, earlier = [x], [v], [], v
    for t in range(scene.steps):
        (x, v, a), earlier = paper_step(body, brain, scene, own, t, x, v, earlier, rest), v
        xs.append(x)
        vs.append(v)
        activations.append(a)
    xs = np.array(xs)
    if scene.integrator == "second-order":  # positions are kept half a step after velocities
        xs[1:] = (xs[1:] + xs[:-1]) / 2
        xs[0] = start
    return xs, np.array(vs), np.array(activations)


def complex_slopes(
    body: Morphology, brain: Controller, scene: Scene, physics: Physics, along: Physics, weights: Controller,
    *pulls: MotionCotangents,
) -> list[float]:  # fmt: skip
    """Changes of the loss and of each pull's product with the motion, as physics change by `along` and the
    controller by `weights`: by a complex step, which has no rounding error to speak of."""
    own, acting = (
        SimpleNamespace(**{f.name: getattr(r, f.name) + 1e-30j * getattr(d, f.name) for f in fields(r)})
        for r, d in ((physics, along), (brain, weights))
    )
    motion = paper_rollout(body, acting, scene, own)
    values = [(motion[0][0] - motion[0][-1])[:, 0].mean()]
    for pull in pulls:
        values.append(sum((p * m).sum() for p, m in zip(pull, motion, strict=True) if p is not None))
    return [float(value.imag / 1e-30) for value in values]


def strip_force(stretch: float, length: float, tension: float, buckling: float) -> float:
    """Tension positive [N]; in compression at most the buckling load, growing a little with bending."""
    if stretch >= 0:
        return tension * stretch
    return -min(-tension * stretch, buckling * (1 - stretch / (2 * length)))


def built_step(
    robot: PrintedRobot,
    terrain: Terrain | None,
    rest: np.ndarray,
    stiffness: np.ndarray,
    dt: float,
    state: np.ndarray,
) -> np.ndarray:
    """The state (4 or 7, M) after `dt`: x, y, vx, vy, cosine, sine, spin."""
    p = robot.parameters
    x, v = state[:2].T, state[2:4].T
    impulse, twist = np.zeros_like(x), np.zeros(len(x))
    for s, (a, b) in enumerate(robot.springs):
        d = x[a] - x[b]
        length = np.linalg.norm(d) + 1e-12  # as the engine, which never divides by 0
        stretch = length - rest[s]
        if robot.active[s]:
            force = stiffness[s] * stretch
        else:
            force = strip_force(stretch, rest[s], stiffness[s], robot.buckling[s])
        force += robot.damping[s] * ((v[a] - v[b]) @ d) / length
        pull = force * d / length
        if robot.joints == "clamped" and not robot.active[s]:
            ma, mb = end_moments(robot, s, state)
            pull -= (ma + mb) / length**2 * np.array([-d[1], d[0]])
            twist[[a, b]] -= dt * ma, dt * mb
        impulse[a] -= dt * pull
        impulse[b] += dt * pull
    v = np.exp(-p.drag * dt) * v + impulse / robot.masses[:, None] + down(p) * dt
    for i in range(len(x)):
        v[i] = landed(robot, i, ground_below(terrain, x[i, 0]), x[i], v[i], dt, terrain is not None)
        if terrain is not None:
            v[i] = landed(robot, i, ground_below(terrain, x[i, 0] + dt * v[i, 0]), x[i], v[i], dt, True)
    after = [(x + dt * v).T, v.T]
    if robot.joints == "clamped":
        spin = np.exp(-p.drag * dt) * state[6] + twist / robot.inertias
        turned = (state[4] + 1j * state[5]) * (1 + 0.5j * dt * spin) / (1 - 0.5j * dt * spin)
        after.append(np.array([turned.real, turned.imag, spin]))
    return np.concatenate(after)


def landed(
    robot: PrintedRobot,
    i: int,
    line: tuple[np.ndarray, float],
    x: np.ndarray,
    v: np.ndarray,
    dt: float,
    slowly: bool,
) -> np.ndarray:
    """Velocity of mass i after the impulse of the ground below it, which is a line; `slowly`: what is below
    the line comes out of it at 1 mm/s."""
    n, d = line
    along = np.array([n[1], -n[0]])
    gap, sliding, away = x @ n - d, v @ along, v @ n
    stopped = min(-gap / dt, 1e-3) if slowly else -gap / dt
    if away >= stopped:
        return v
    grip = robot.friction[i] * (stopped - away) * (robot.parameters.backward_friction if sliding < 0 else 1.0)
    return np.sign(sliding) * max(abs(sliding) - grip, 0.0) * along + stopped * n


def end_moments(robot: PrintedRobot, s: int, state: np.ndarray) -> np.ndarray:
    """At both ends of a clamped strip [N m]: its bending energy's slope in its ends' rotations from the
    chord, E = E I / l (2 pa^2 + 2 pa pb + 2 pb^2), each rotation a little ahead of itself (damping)."""
    a, b = robot.springs[s]
    d, u = state[:2, a] - state[:2, b], state[2:4, a] - state[2:4, b]
    rest = robot.positions[a] - robot.positions[b]
    chord = np.arctan2(d[1], d[0]) - np.arctan2(rest[1], rest[0])
    ahead = []
    for i in (a, b):
        rotation = np.arctan2(state[5, i], state[4, i]) - chord
        rotation = (rotation + np.pi) % (2 * np.pi) - np.pi
        rate = state[6, i] - (d[0] * u[1] - d[1] * u[0]) / (d @ d)
        ahead.append(rotation + robot.bending_delay * rate)
    return robot.parameters.bending * np.array([[4.0, 2.0], [2.0, 4.0]]) @ np.array(ahead)


def built_run(
    robot: PrintedRobot,
    lengths: np.ndarray,
    interval: float,
    substeps: int,
    free: tuple[float, float],
    terrain: Terrain | None = None,
    start: np.ndarray | None = None,
) -> np.ndarray:
    """Positions at every instant of the table of free lengths (K + 1, A), shape (K + 1, M, 2)."""
    p, motors = robot.parameters, np.flatnonzero(robot.active)
    hot = np.clip((lengths - free[0]) / (free[1] - free[0]), 0, 1)
    stiffnesses = p.cold_stiffness + (p.hot_stiffness - p.cold_stiffness) * hot
    state = np.zeros((4 if robot.joints == "pins" else 7, len(robot.masses)))
    state[:2], state[4:5] = robot.positions.T, 1.0
    state = state if start is None else start.copy()
    step_of = HubStep(robot, terrain) if robot.joints == "hubs" else partial(built_step, robot, terrain)
    rest, stiffness, positions = robot.rest_lengths.copy(), robot.stiffness.copy(), [state[:2].T]
    for k in range(len(lengths) - 1):
        for step in range(1, substeps + 1):
            part = step / substeps
            rest[motors] = (1 - part) * lengths[k] + part * lengths[k + 1]
            stiffness[motors] = (1 - part) * stiffnesses[k] + part * stiffnesses[k + 1]
            state = step_of(rest, stiffness, interval / substeps, state)
        positions.append(state[:2].T)
    return np.array(positions)
