"""Twin of the engine's hubs in NumPy, one hub and one strip after the other, with matrices and angles."""

import numpy as np

from eldir.built.robot import PrintedRobot
from eldir.built.stability import STICKS
from eldir.parameters.printed import BuiltParameters
from eldir.terrain import Terrain

CORNERS = np.radians(-90 + 60 * np.arange(6))


def turned(angle: float, vector: np.ndarray) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]]) @ vector


def cross(a: np.ndarray, b: np.ndarray) -> float:
    return float(a[0] * b[1] - a[1] * b[0])


def least_bent(angles: np.ndarray, play: float) -> np.ndarray:
    """Angles of a strip's ends from its chord, within the play of those of its hubs, with the least
    bending energy pa^2 + pa pb + pb^2: first each corner and edge of the box, then the middle."""
    low, high = angles - play, angles + play
    found = [np.array([a, b]) for a in (low[0], high[0]) for b in (low[1], high[1])]
    found += [np.array([a, np.clip(-a / 2, low[1], high[1])]) for a in (low[0], high[0])]
    found += [np.array([np.clip(-b / 2, low[0], high[0]), b]) for b in (low[1], high[1])]
    if (low <= 0).all() and (high >= 0).all():
        return np.zeros(2)
    return min(found, key=lambda p: p[0] ** 2 + p[0] * p[1] + p[1] ** 2)


def ground_below(terrain: Terrain | None, x: float) -> tuple[np.ndarray, float]:
    """Normal and distance from the origin of the line that is the ground at x: n . place = d on it."""
    if terrain is None:
        return np.array([0.0, 1.0]), 0.0
    begun = [i for i, start in enumerate(terrain.x0) if start <= x]
    m, b = terrain.slope[max(begun, default=0)], terrain.intercept[max(begun, default=0)]
    return np.array([-m, 1.0]) / np.hypot(1.0, m), float(b / np.hypot(1.0, m))


def down(p: BuiltParameters) -> np.ndarray:
    """Gravity along a table that falls forward, and across it [m/s2]."""
    return -p.gravity * np.array([np.sin(p.tilt), -np.cos(p.tilt)])


class HubStep:
    """One step of a robot with hubs; it remembers how far each socket's friction has been dragged along."""

    def __init__(self, robot: PrintedRobot, terrain: Terrain | None = None):
        self.robot, self.terrain = robot, terrain
        self.dragged = np.zeros((len(robot.springs), 2))

    def __call__(self, rest: np.ndarray, stiffness: np.ndarray, dt: float, state: np.ndarray) -> np.ndarray:
        """The state (7, M) after `dt`: x, y, vx, vy, cosine, sine, spin."""
        r, p = self.robot, self.robot.parameters
        x, v, spin = state[:2].T.copy(), state[2:4].T.copy(), state[6].copy()
        angle = np.arctan2(state[5], state[4])
        force, moment = np.zeros_like(x), np.zeros(len(x))
        for s, ends in enumerate(r.springs):
            arms = [-p.socket * turned(angle[ends[0]], r.directions[s])]
            arms += [p.socket * turned(angle[ends[1]], r.directions[s])]
            hinges = [x[i] + arm for i, arm in zip(ends, arms, strict=True)]
            speeds = [v[i] + spin[i] * turned(np.pi / 2, arm) for i, arm in zip(ends, arms, strict=True)]
            d, u = hinges[0] - hinges[1], speeds[0] - speeds[1]
            length = float(np.linalg.norm(d)) + 1e-12
            n = d / length
            natural = rest[s] - 2 * p.socket
            pull = r.damping[s] * float(u @ n)
            moments = np.zeros(2)
            if r.active[s]:
                pull += stiffness[s] * (length - natural)
            else:
                pull += self.strip(s, length - natural, natural, stiffness[s])
                moments = self.bent(s, n, cross(n, u) / length, angle[ends], spin[ends])
            whole = pull * n + moments.sum() / length * np.array([n[1], -n[0]])
            for i, arm, side, end in zip(ends, arms, (-1, 1), moments, strict=True):
                force[i] += side * whole
                moment[i] += cross(arm, side * whole) - end
        v = np.exp(-p.drag * dt) * v + dt * force / r.masses[:, None] + down(p) * dt
        spin = np.exp(-p.drag * dt) * spin + dt * moment / r.inertias
        for i in range(len(x)):
            v[i], spin[i] = self.landed(i, x[i], v[i], angle[i], spin[i], dt)
        rotation = (state[4] + 1j * state[5]) * (1 + 0.5j * dt * spin) / (1 - 0.5j * dt * spin)
        return np.array([*(x + dt * v).T, *v.T, rotation.real, rotation.imag, spin])

    def strip(self, s: int, stretch: float, length: float, tension: float) -> float:
        if stretch >= 0:
            return tension * stretch
        return -min(-tension * stretch, self.robot.buckling[s] * (1 - stretch / (2 * length)))

    def bent(self, s: int, n: np.ndarray, turning: float, angle: np.ndarray, spin: np.ndarray) -> np.ndarray:
        """Moments that the strip needs at its ends [N m]."""
        r, p = self.robot, self.robot.parameters
        sines = np.array([cross(n, turned(a, r.directions[s])) for a in angle])
        now = sum(c * sines ** (2 * k + 1) for k, c in enumerate((1, 1 / 6, 3 / 40, 15 / 336, 105 / 3456)))
        ahead = now + r.bending_delay * (spin - turning)
        bending = p.bending * np.array([[4.0, 2.0], [2.0, 4.0]]) @ least_bent(ahead, p.socket_turn)
        strain = np.clip(now - self.dragged[s], -STICKS, STICKS)
        self.dragged[s] = now - strain
        held = np.clip(ahead - self.dragged[s], -STICKS, STICKS)
        return bending + p.socket_friction * held / STICKS

    def landed(
        self, i: int, x: np.ndarray, v: np.ndarray, angle: float, spin: float, dt: float
    ) -> tuple[np.ndarray, float]:
        """Speeds after the impulses of the table on the lowest corner, or of a terrain on each lower one."""
        p = self.robot.parameters
        corners = p.corner * np.stack([np.cos(CORNERS + angle), np.sin(CORNERS + angle)], axis=1)
        if self.terrain is None:
            return self.pushed(i, x, v, corners[np.argmin(corners[:, 1])], spin, dt, 0.0)
        lower = (-1, 0, 1) if np.abs(self.terrain.slope).max() < 1.7 else (-2, -1, 0, 1, 2)
        for ahead in (0.0, dt):
            for k in lower:
                v, spin = self.pushed(i, x, v, corners[k], spin, dt, ahead)
        return v, spin

    def pushed(
        self, i: int, x: np.ndarray, v: np.ndarray, arm: np.ndarray, spin: float, dt: float, ahead: float
    ) -> tuple[np.ndarray, float]:
        """Speeds after the impulse on one corner, of the ground that is under it after the time `ahead`,
        computed in the frame of its slope."""
        r, p = self.robot, self.robot.parameters
        place, speed = x + np.array([0, p.corner]) + arm, v + spin * turned(np.pi / 2, arm)
        n, distance = ground_below(self.terrain, (place + ahead * speed)[0])
        gap = place @ n - distance
        if self.terrain is not None:
            gap = max(gap, -1e-3 * dt)
        slope = np.arctan2(-n[0], n[1])
        arm, speed = turned(-slope, arm), turned(-slope, speed)
        if gap + dt * speed[1] >= 0:
            return v, spin
        # Impulse (along, up) -> change of the corner's speed.
        levers = np.array([-arm[1], arm[0]])
        gives = np.eye(2) / r.masses[i] + np.outer(levers, levers) / r.inertias[i]
        wanted = np.array([-speed[0], -gap / dt - speed[1]])
        impulse = np.linalg.solve(gives, wanted)
        mu = r.friction[i] * (p.backward_friction if impulse[0] > 0 else 1.0)
        if abs(impulse[0]) > mu * impulse[1]:
            slides = np.array([np.copysign(mu, impulse[0]), 1.0])
            impulse = slides * wanted[1] / (gives @ slides)[1]
        return v + turned(slope, impulse) / r.masses[i], spin + float(levers @ impulse) / r.inertias[i]
