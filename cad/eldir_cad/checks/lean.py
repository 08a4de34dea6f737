"""How far a robot leans whose faces differ: a reduced model of two planes that connectors join.

A walk bends each plane by centimetres, and the faces differ by millimetres. So the motion in the plane is
taken as given, as poses, and only what differs between the faces is solved for, quasi-statically, pose after
pose, to first order:

- **Hubs** are rigid pairs of discs. Unknown are their slopes t (of the axis from front to back, along x and
  z), and their shifts y to the back. The faces then differ by 2 s t, with s the distance of the springs from
  the middle. Strips keep their lengths, so t is a motion of the plane without its motors: a mechanism.
- **Coils** of both faces push with their own forces, and so drive the mechanism.
- **Sockets** let a strip turn out of its plane within their play, with friction, then it bends on edge.
- **Feet** of both faces stand on the table, or lift; they do not slide sideways below Coulomb's limit.
- **Weight** presses feet down, and pushes over what leans (P-delta): each spring carries an axial force, and
  sways out under it.

Friction makes the state depend on what was before, so poses must be in the order of the motion. Each is a
minimum of an energy with history (rate-independent plasticity). Lengths in metres; x forward, y to the back,
z up. Sources of the numbers: `eldir_cad.checks.lateral_stability`; how good it is:
docs/reference/second-physics-measured.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eldir.core.records import BoolArray, FloatArray, IntArray
from eldir.parameters.wiring import FACES
from eldir_cad.checks.kinematics import rigidity_matrix

FALLEN = np.radians(60)
"""Roll beyond which a robot has fallen over sideways [rad]; the model then ends."""
_RANK = 1e-6  # of the largest singular value
_NEAR_TABLE = 1e-3  # height above the lowest hub up to which a hub carries load [m]
_MIN_FEET = 2
_CONTACT_STIFFNESS = 2e3  # of a foot; the weight of a robot then presses it in by 0.1 mm [N/m]
_TURN_ELASTIC = np.radians(1.5)  # rotation of a strip in its socket before it slips; calibrated [rad]
_SLIDE_ELASTIC = 2e-4  # shift of a foot before it slips [m]
_MIN_LOAD = 0.02  # of a foot, so that robots are held where statics say that it carries none [N]
_HOLD = 1e-3  # stiffness against rigid shifts to the side [N/m]
_MIN_CURVATURE = 1e-5
_MAX_STEP = 0.1  # of any unknown [m, rad]: a robot that no foot carries would move without bound
_MAX_ITERATIONS, _PRECISION = 40, 1e-6
_FAR = 2.0  # unknown beyond which the robot has fallen [m, rad]
_SAME = 2e-4  # change of a pose and its coils up to which it is taken for the one before [m]


@dataclass(frozen=True)
class BiplaneSection:
    """What makes a robot stiff or wide out of its plane."""

    springs_at: float
    """Distance from the middle of the robot to the springs of a face [m]."""
    outside: float
    """Distance from the middle to the outer edge of its discs, on which it stands [m]."""
    corner: float
    """Distance from a hub's centre to its corners [m]."""
    socket: float
    """Distance from a hub's centre to the hinges in its sockets [m]."""
    play: float
    """Rotation of a strip out of its plane in a socket, either way, beyond which it bends [rad]."""
    edge_stiffness: float
    """Moment on the end of a strip for each radian beyond its play [N m/rad]."""
    foot_friction: float
    """Coulomb coefficient of the feet."""
    gravity: float
    """Downwards [m/s2]."""


@dataclass(frozen=True)
class Condition:
    """A case for which the lean is predicted."""

    socket_friction: float
    """Moment at which a strip of one face begins to turn in a socket [N m]."""
    side_tilt: float = 0.0
    """Slope of the table to the back [rad]."""


@dataclass(frozen=True, eq=False)
class Frame:
    """A body: what its poses have in common."""

    springs: IntArray
    """Mass indices of every spring, shape (S, 2)."""
    active: BoolArray
    """Whether a spring is a motor, shape (S,)."""
    masses: FloatArray
    """Masses of the hubs, both faces together [kg], shape (M,)."""
    section: BiplaneSection

    def tipping_angles(self, poses: FloatArray) -> FloatArray:
        """Lean at which the centre of mass is above the outer edge of the feet [rad], shape (T,)."""
        heights = poses[..., 1] - poses[..., 1].min(axis=1, keepdims=True) + self.section.corner
        return np.arctan2(self.section.outside, heights @ self.masses / self.masses.sum())


@dataclass(frozen=True, eq=False)
class CoilTable:
    """Coils in each pose, the front and the back one of each motor, shape (T, A, 2) each."""

    lengths: FloatArray
    """Free lengths between the hubs' centres [m]."""
    stiffness: FloatArray
    """Stiffness of each coil [N/m]."""


@dataclass(frozen=True, eq=False)
class Lean:
    """How a robot leaves its plane, in each pose."""

    roll: FloatArray
    """Lean about its direction of travel, positive to the front [rad], shape (T,); pi / 2 after a fall."""
    yaw: FloatArray
    """Rotation about the vertical [rad], shape (T,); NaN after a fall."""
    slopes: FloatArray
    """Slopes of the hubs' axes along x and z, from front to back, shape (T, M, 2); NaN after a fall."""
    shifts: FloatArray
    """Shifts of the hubs to the back [m], shape (T, M); NaN after a fall."""
    tipping: FloatArray
    """Tipping angle of each pose [rad], shape (T,)."""

    @property
    def max_roll(self) -> float:
        """Largest lean to either side [rad]; pi / 2 for a robot that falls."""
        return float(np.abs(self.roll).max(initial=0.0))

    @property
    def margin(self) -> float:
        """Smallest tipping angle less lean [rad]; negative for a robot that falls."""
        return float((self.tipping - np.abs(self.roll)).min(initial=np.pi / 2))


def predict_lean(
    frame: Frame, poses: FloatArray, coils: CoilTable, conditions: Sequence[Condition]
) -> list[Lean]:
    """Lean of a robot that moves through these poses on a table [m], shape (T, M, 2), for each condition.

    It begins without lean and without strain in its sockets. Poses that equal the one before are not
    calculated anew.
    """
    count, masses = poses.shape[:2]
    tipping = frame.tipping_angles(poses)
    leans = [
        Lean(
            np.zeros(count), np.zeros(count), np.zeros((count, masses, 2)), np.zeros((count, masses)), tipping
        )
        for _ in conditions
    ]
    states: list[_State | None] = [_State.at_rest(frame) for _ in conditions]
    for k, source in enumerate(_source_poses(poses, coils.lengths)):
        energy = None
        for c, (lean, condition) in enumerate(zip(leans, conditions, strict=True)):
            if (state := states[c]) is not None and source == k:
                energy = energy or _Energy(frame, poses[k], coils.lengths[k], coils.stiffness[k])
                states[c] = _step(energy, lean, k, state, condition)
            elif state is not None:
                for values in (lean.roll, lean.yaw, lean.slopes, lean.shifts):
                    values[k] = values[source]
    return leans


def _source_poses(poses: FloatArray, lengths: FloatArray) -> list[int]:
    """For each pose the last one that it differs from by too little to calculate it anew, or itself."""
    centred = poses - poses.mean(axis=1, keepdims=True) * [1.0, 0.0]
    sources: list[int] = []
    for k in range(len(poses)):
        last = sources[-1] if sources else k
        moved = max(np.abs(values[k] - values[last]).max(initial=0.0) for values in (centred, lengths))
        sources.append(last if moved < _SAME else k)
    return sources


def _step(energy: _Energy, lean: Lean, k: int, state: _State, condition: Condition) -> _State | None:
    """Enter pose `k` into `lean`. Returns the state in it; None after a fall."""
    after = energy.minimise(state, condition)
    lean.roll[k], lean.yaw[k] = energy.rotation(after)
    lean.slopes[k], lean.shifts[k] = after.slopes, after.shifts
    if abs(lean.roll[k]) <= FALLEN:
        return after
    lean.roll[k:] = np.copysign(np.pi / 2, lean.roll[k])
    for values in (lean.yaw, lean.slopes, lean.shifts):
        values[k:] = np.nan
    return None


@dataclass(frozen=True, eq=False)
class _State:
    """Where the robot is, and where friction holds it."""

    slopes: FloatArray
    shifts: FloatArray
    lift: FloatArray  # of the whole robot [m], and its pitch [rad]
    turned: FloatArray  # rotations of strips in their sockets that friction holds [rad], shape (2 P,)
    placed: FloatArray  # places to the back at which friction holds the feet [m], shape (M,)

    @classmethod
    def at_rest(cls, frame: Frame) -> _State:
        masses, strips = len(frame.masses), int((~frame.active).sum())
        return cls(
            np.zeros((masses, 2)), np.zeros(masses), np.zeros(2), np.zeros(2 * strips), np.zeros(masses)
        )


class _Energy:
    """Energy of a pose in the unknowns x: amplitudes of the mechanisms, shifts, lift and pitch.

    x H x / 2 - f x for coils, weight and axial forces. Rows are linear functions of x with a force each: gaps
    under the feet of both faces, rotations in the sockets at both ends of the strips, places of the feet.
    """

    def __init__(self, frame: Frame, pose: FloatArray, lengths: FloatArray, stiffness: FloatArray):
        self._section, self._frame, self._pose = frame.section, frame, pose
        count = len(pose)
        self._motions = _motions_without_motors(frame, pose)
        self._modes = modes = self._motions.shape[1]
        size = modes + count + 2
        self._slope = np.zeros((count, 2, size))
        self._slope[:, :, :modes] = self._motions.reshape(count, 2, modes)
        self._shift = np.zeros((count, size))
        self._shift[:, modes:-2] = np.eye(count)
        self._rise = np.zeros((count, size))
        self._rise[:, -2] = 1.0
        self._rise[:, -1] = pose[:, 0] - frame.masses @ pose[:, 0] / frame.masses.sum()
        heights = pose[:, 1] - pose[:, 1].min()
        self._grounded = _load_bearing(heights)
        self._tension, self._loads = _axial_forces(frame, pose, self._grounded)
        self._grip = self._section.foot_friction * np.maximum(self._loads[self._grounded], _MIN_LOAD)
        self._assemble_rows(heights)
        self._assemble_energy(lengths, stiffness)

    def _assemble_rows(self, heights: FloatArray) -> None:
        s, (a, b) = self._section, self._frame.springs.T
        along = self._pose[b] - self._pose[a]
        self._distance = np.linalg.norm(along, axis=1)
        self._along = along / self._distance[:, None]
        self._tilts = [np.einsum("si,sin->sn", self._along, self._slope[ends]) for ends in (a, b)]
        self._hinged = self._distance - 2 * s.socket
        aside = self._shift[b] - self._shift[a] + s.socket * (self._tilts[0] + self._tilts[1])
        self._sway = aside / self._hinged[:, None]
        leans = s.outside * self._slope[:, 1]
        self._footing = self._shift + s.corner * self._slope[:, 1]
        passive = ~self._frame.active
        feet = [self._rise - leans, self._rise + leans]
        sockets = [(tilt + self._sway)[passive] for tilt in self._tilts]
        self._rows = np.concatenate([*feet, *sockets, self._footing[self._grounded]])
        self._gaps = np.concatenate([heights, heights])
        self._splits = np.cumsum([len(self._gaps), 2 * int(passive.sum())])

    def _assemble_energy(self, lengths: FloatArray, stiffness: FloatArray) -> None:
        s, frame = self._section, self._frame
        (a, b), active = frame.springs.T, frame.active
        between = self._slope[b] - self._slope[a]
        longer = s.springs_at * np.einsum("si,sin->sn", self._along[active], between[active])
        push = stiffness * (lengths - self._distance[active, None])
        weight = s.gravity * frame.masses
        self._linear = longer.T @ (push[:, 1] - push[:, 0]) - weight @ self._rise
        self._aside = weight @ self._shift  # force of a slope of 1 sideways
        across = np.stack([-self._along[:, 1], self._along[:, 0]], axis=1)
        twist = s.springs_at * np.einsum("si,sin->sn", across, between)
        rows = np.concatenate([longer, self._sway, *self._tilts, twist, self._slope[:, 1]])
        pull = self._tension
        arms = pull * s.socket
        factors = [
            stiffness.sum(axis=1), pull * self._hinged, arms, arms, pull / self._distance,
            -s.corner * self._loads,
        ]  # fmt: skip
        held = np.zeros(rows.shape[1])
        held[: self._modes], held[self._modes : -2] = _HOLD * 1e-3, _HOLD
        self._quadratic = (rows.T * np.concatenate(factors)) @ rows + np.diag(held)

    def minimise(self, before: _State, condition: Condition) -> _State:
        """Newton's method from the state before, by a saddle-free step where the energy is not convex."""
        self._before, self._friction = before, len(FACES) * condition.socket_friction
        self._force = self._linear + condition.side_tilt * self._aside
        x = np.concatenate([self._motions.T @ before.slopes.ravel(), before.shifts, before.lift])
        value = self._value(x)
        for _ in range(_MAX_ITERATIONS):
            gradient, hessian = self._derivatives(x)
            step = _descent(hessian, gradient)
            slope, length = gradient @ step, 1.0
            while (new := self._value(x + length * step)) > value + 1e-4 * length * slope:
                length /= 2
                if length < _PRECISION:
                    break
            x, value = x + length * step, new
            if min(length, np.abs(step).max()) < _PRECISION or np.abs(x).max() > _FAR:
                break
        return self._state(x)

    def _strains(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Depth of the feet in the table, rotations beyond the play, and slips in sockets and of feet, as
        parts of those at which they begin to slip."""
        gap, turn, place = np.split(self._rows @ x, self._splits)
        play, before = self._section.play, self._before
        beyond = turn - np.clip(turn, -play, play)
        held = (turn - before.turned) / _TURN_ELASTIC
        slid = (place - before.placed[self._grounded]) / _SLIDE_ELASTIC
        return np.minimum(gap + self._gaps, 0.0), beyond, held, slid

    def _value(self, x: FloatArray) -> float:
        depth, beyond, held, slid = self._strains(x)
        smooth = x @ (self._quadratic @ x) / 2 - self._force @ x
        springs = _CONTACT_STIFFNESS * (depth @ depth) + len(FACES) * self._section.edge_stiffness * (
            beyond @ beyond
        )
        sockets = self._friction * _TURN_ELASTIC * _huber(held).sum()
        return float(smooth + springs / 2 + sockets + _SLIDE_ELASTIC * (self._grip @ _huber(slid)))

    def _derivatives(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gradient and Hessian matrix of the energy."""
        depth, beyond, held, slid = self._strains(x)
        edge, friction = len(FACES) * self._section.edge_stiffness, self._friction
        forces = np.concatenate([
            _CONTACT_STIFFNESS * depth,
            edge * beyond + friction * np.clip(held, -1, 1),
            self._grip * np.clip(slid, -1, 1),
        ])  # fmt: skip
        touching = self._rows[: self._splits[0]] @ x + self._gaps <= 0
        rates = np.concatenate([
            _CONTACT_STIFFNESS * touching,
            edge * (beyond != 0) + friction / _TURN_ELASTIC * (np.abs(held) < 1),
            self._grip / _SLIDE_ELASTIC * (np.abs(slid) < 1),
        ])  # fmt: skip
        gradient = self._quadratic @ x - self._force + self._rows.T @ forces
        return gradient, self._quadratic + (self._rows.T * rates) @ self._rows

    def _state(self, x: FloatArray) -> _State:
        before, grounded = self._before, self._grounded
        _, turn, place = np.split(self._rows @ x, self._splits)
        placed = self._footing @ x
        placed[grounded] = np.clip(before.placed[grounded], place - _SLIDE_ELASTIC, place + _SLIDE_ELASTIC)
        turned = np.clip(before.turned, turn - _TURN_ELASTIC, turn + _TURN_ELASTIC)
        return _State(self._slope @ x, x[self._modes : -2], x[-2:], turned, placed)

    def rotation(self, state: _State) -> tuple[float, float]:
        """Roll and yaw of the rotation that fits the displacements of all discs best [rad]."""
        x, z = (self._pose - self._pose.mean(axis=0)).T
        aside = self._section.springs_at
        rise = state.lift[0] + self._rise[:, -1] * state.lift[1]
        shifts, lifts = state.shifts - state.shifts.mean(), rise - rise.mean()
        # Sums over the discs of both faces; what is odd in the face cancels.
        moments = np.array([
            aside**2 * state.slopes[:, 1].sum() - z @ shifts,
            -(x @ lifts),
            x @ shifts - aside**2 * state.slopes[:, 0].sum(),
        ])  # fmt: skip
        xx, zz, xz, yy = x @ x, z @ z, x @ z, len(x) * aside**2
        inertia = np.array([[yy + zz, 0.0, -xz], [0.0, xx + zz, 0.0], [-xz, 0.0, xx + yy]])
        roll, _, yaw = np.linalg.solve(inertia, moments)
        return float(roll), float(yaw)


def _motions_without_motors(frame: Frame, pose: FloatArray) -> FloatArray:
    """Orthonormal motions of the plane that change the length of no strip, shape (2 M, F)."""
    rows = rigidity_matrix(pose, frame.springs[~frame.active])
    if not len(rows):
        return np.eye(2 * len(pose))
    _, sizes, motions = np.linalg.svd(rows)
    return np.asarray(motions[int((sizes > _RANK * sizes[0]).sum()) :].T)


def _load_bearing(heights: FloatArray) -> IntArray:
    """Hubs on which the robot stands, two at least."""
    near = np.flatnonzero(heights < _NEAR_TABLE)
    return near if len(near) >= _MIN_FEET else np.argsort(heights, kind="stable")[:_MIN_FEET]


def _axial_forces(frame: Frame, pose: FloatArray, grounded: IntArray) -> tuple[FloatArray, FloatArray]:
    """Tension in every spring, both faces together [N], shape (S,), and load on each hub [N], shape (M,).

    Statics under the weight, on feet without friction; of redundant bodies the solution of least forces.
    """
    count, springs = len(pose), len(frame.springs)
    matrix = np.zeros((2 * count, springs + len(grounded)))
    matrix[:, :springs] = -rigidity_matrix(pose, frame.springs).T
    matrix[2 * grounded + 1, springs + np.arange(len(grounded))] = 1.0
    load = np.zeros(2 * count)
    load[1::2] = frame.section.gravity * frame.masses
    solved = np.linalg.lstsq(matrix, load, rcond=_RANK)[0]
    loads = np.zeros(count)
    loads[grounded] = solved[springs:]
    return solved[:springs], loads


def _descent(hessian: FloatArray, gradient: FloatArray) -> FloatArray:
    """Newton's step; with the eigenvalues' magnitudes where the energy is not convex."""
    values, vectors = np.linalg.eigh(hessian)
    step = -vectors @ ((vectors.T @ gradient) / np.maximum(np.abs(values), _MIN_CURVATURE))
    return np.asarray(step * min(1.0, _MAX_STEP / np.abs(step).max(initial=_MAX_STEP)))


def _huber(share: FloatArray) -> FloatArray:
    """Energy of a friction that is elastic up to 1 and then slips, as a part of force times elastic way."""
    size = np.abs(share)
    return np.where(size < 1, size**2 / 2, size - 0.5)
