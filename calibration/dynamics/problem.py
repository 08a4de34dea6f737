"""An identification as a least-squares problem: residuals and slopes, asked for by an optimiser."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from calibration.dynamics.linearisation import Linear, linearise
from calibration.dynamics.measurements import UNREAD, Bench
from calibration.dynamics.recording import Body, Recording, predict
from calibration.dynamics.residuals import Misfit, misfit
from eldir.core.records import FloatArray
from eldir.parameters.robot import RobotParameters, robot_at
from eldir.parameters.uncertain import is_unobservable

_LOST = 1e3  # standard deviations that each residual counts where a specimen blew up
NEARLY = 7  # robots nearly the same; with the one itself they fill a group of the engine's lanes
_NEAR = 0.1  # of the turns for slopes: as far as straight slopes are asked to reach


@dataclass
class Problem:
    """Residuals and slopes at turns z of the knobs, with the last answers kept."""

    body: Body
    recordings: Sequence[Recording]
    nominal: RobotParameters
    names: Sequence[str]
    noise: tuple[float, float]
    """Of shape and of walk per second [m]."""
    turns: FloatArray
    """To both sides, for slopes, shape (knobs,)."""
    bench: Bench = UNREAD
    evaluations: int = 0
    """Batches of specimens that were driven."""
    _at: FloatArray = field(default_factory=lambda: np.zeros(0))
    _linear: Linear | None = None

    def residuals(self, z: FloatArray) -> FloatArray:
        """Of tracks and priors, in standard deviations."""
        if self._linear is not None and np.array_equal(self._at, z):
            positions = self._linear.positions
        else:
            self.evaluations += 1
            positions = [x[0] for x in self._motions([z])]
        return np.concatenate([self._scaled(self.misfits(positions)), self._known(z)])

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Of `residuals`, shape (values, knobs)."""
        linear = self.linear(z)
        moved = [misfit(r, -s) for r, s in zip(self.recordings, linear.slopes, strict=True)]
        return np.concatenate([self._scaled(moved).T, self.known_slopes(z)])

    def linear(self, z: FloatArray) -> Linear:
        """The motion and its slopes at `z`."""
        if self._linear is None or not np.array_equal(self._at, z):
            self.evaluations += 1
            self._at = z.copy()
            self._linear = linearise(self.body, self.recordings, self.nominal, self.names, z, self.turns)
        return self._linear

    def chance(self, z: FloatArray) -> list[Misfit]:
        """Of robots nearly the same as at `z`, from what the slopes say of them: how differently feet land,
        and how little straight the motion is, shapes (n, ...)."""
        signs = np.random.default_rng(len(z)).choice([-1.0, 1.0], (NEARLY, len(z)))
        off = _NEAR * signs * self.turns * [not is_unobservable(name) for name in self.names]
        motions = self._motions([z, *(z + off)])
        return [
            misfit(r, np.nan_to_num(x[1:] - x[0] - np.tensordot(off, slopes, 1)))
            for r, x, slopes in zip(self.recordings, motions, self.linear(z).slopes, strict=True)
        ]

    def _motions(self, places: Sequence[FloatArray]) -> list[FloatArray]:
        """Of each recording, shape (places, frames, marks, 2)."""
        tried = [robot_at(self.body.morphology, self.nominal, self.names, z) for z in places]
        return predict(self.body, self.recordings, tried)

    def _known(self, z: FloatArray) -> FloatArray:
        """How far priors and readings are from `z`, in standard deviations."""
        if self.bench == UNREAD:
            return z
        turned = robot_at(self.body.morphology, self.nominal, self.names, z)
        return np.append(z, self.bench.off(self.body, turned))

    def known_slopes(self, z: FloatArray) -> FloatArray:
        """Of what is known without a film."""
        steps = 1e-4 * np.eye(len(z))
        return np.stack([(self._known(z + s) - self._known(z - s)) / 2e-4 for s in steps], axis=1)

    def misfits(self, positions: Sequence[FloatArray]) -> list[Misfit]:
        """Of predictions, one for each recording; huge where a specimen blew up."""
        return [
            misfit(r, np.nan_to_num(r.tracked.positions - x, nan=0.0) + _LOST * self.noise[0] * _gone(r, x))
            for r, x in zip(self.recordings, positions, strict=True)
        ]

    def _scaled(self, misfits: Sequence[Misfit]) -> FloatArray:
        return np.concatenate([m.scaled(*self.noise) for m in misfits], axis=-1)


def _gone(recording: Recording, positions: FloatArray) -> FloatArray:
    """1 where a mark was seen and the prediction has none, to and fro so that no mean takes it away."""
    lost = np.isfinite(recording.tracked.positions) & ~np.isfinite(positions)
    return 1.0 * lost * np.where(np.arange(len(positions)) % 2, 1.0, -1.0)[:, None, None]
