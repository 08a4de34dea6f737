"""An identification as a least-squares problem: what is compared with what, and how it is scaled.

A problem is fixed and has no state: the same question gives the same answer. What an optimiser asks for
repeatedly, and how often it did, is kept by `calibration.dynamics.evaluation.Evaluator`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.dynamics.individual import individual, silent
from calibration.dynamics.linearisation import Linear, linearise
from calibration.dynamics.measurements import UNREAD, Bench
from calibration.dynamics.recording import Body, Recording, predict
from calibration.dynamics.residuals import Misfit, misfit
from eldir.core.records import FloatArray
from eldir.parameters.uncertain import Specimen

_LOST = 1e3  # standard deviations that each residual counts where a specimen blew up
NEARLY = 7  # robots nearly the same; with the one itself they fill a group of the engine's lanes
_NEAR = 0.1  # of the turns for slopes: as far as straight slopes are asked to reach


@dataclass(frozen=True, eq=False)
class Problem:
    """Recordings of one robot, the parameters that may change, and the scale of every residual."""

    body: Body
    recordings: Sequence[Recording]
    nominal: Specimen
    names: Sequence[str]
    """Of the P parameters."""
    noise: tuple[float, float]
    """Standard deviations of the residuals: of shape, and of walk per second [m]."""
    turns: FloatArray
    """Step widths of the differences, to both sides, in standard deviations of the priors, shape (P,)."""
    bench: Bench = UNREAD

    def positions(self, z: FloatArray) -> list[FloatArray]:
        """Predicted marks at parameters `z` [m], of each recording, shape (frames, marks, 2)."""
        return [x[0] for x in self._motions([z])]

    def linearise(self, z: FloatArray) -> Linear:
        """The predicted motion at `z`, and its slopes."""
        return linearise(self.body, self.recordings, self.nominal, self.names, z, self.turns)

    def residuals(self, z: FloatArray, positions: Sequence[FloatArray]) -> FloatArray:
        """Of tracks, priors and readings, in standard deviations, shape (values,); `positions` are those
        predicted at `z`."""
        return np.concatenate([self._scaled(self.misfits(positions)), self._known(z)])

    def jacobian(self, z: FloatArray, linear: Linear) -> FloatArray:
        """Derivatives of `residuals` by z, shape (values, P); `linear` is the linearisation at `z`."""
        moved = [misfit(r, -s) for r, s in zip(self.recordings, linear.slopes, strict=True)]
        return np.concatenate([self._scaled(moved).T, self.known_slopes(z)])

    def misfits(self, positions: Sequence[FloatArray]) -> list[Misfit]:
        """Of predictions, one for each recording; huge where a specimen blew up."""
        return [
            misfit(r, np.nan_to_num(r.tracked.positions - x, nan=0.0) + _LOST * self.noise[0] * _gone(r, x))
            for r, x in zip(self.recordings, positions, strict=True)
        ]

    def chance(self, z: FloatArray, linear: Linear) -> list[Misfit]:
        """By how much slightly perturbed robots differ from the linearisation at `z`: how differently feet
        land, and how far from linear the motion is, shapes (n, ...)."""
        signs = np.random.default_rng(len(z)).choice([-1.0, 1.0], (NEARLY, len(z)))
        off = _NEAR * signs * self.turns * [not silent(name) for name in self.names]
        motions = self._motions([z, *(z + off)])
        return [
            misfit(r, np.nan_to_num(x[1:] - x[0] - np.tensordot(off, slopes, 1)))
            for r, x, slopes in zip(self.recordings, motions, linear.slopes, strict=True)
        ]

    def known_slopes(self, z: FloatArray) -> FloatArray:
        """Derivatives by z of the residuals of priors and readings, shape (priors and readings, P)."""
        steps = 1e-4 * np.eye(len(z))
        return np.stack([(self._known(z + s) - self._known(z - s)) / 2e-4 for s in steps], axis=1)

    def _motions(self, places: Sequence[FloatArray]) -> list[FloatArray]:
        """Of each recording, shape (places, frames, marks, 2)."""
        tried = [individual(self.body.morphology, self.nominal, self.names, z) for z in places]
        return predict(self.body, self.recordings, tried)

    def _known(self, z: FloatArray) -> FloatArray:
        """How far priors and readings are from `z`, in standard deviations."""
        if self.bench == UNREAD:
            return z
        turned = individual(self.body.morphology, self.nominal, self.names, z)
        return np.append(z, self.bench.off(self.body, turned))

    def _scaled(self, misfits: Sequence[Misfit]) -> FloatArray:
        return np.concatenate([m.scaled(*self.noise) for m in misfits], axis=-1)


def _gone(recording: Recording, positions: FloatArray) -> FloatArray:
    """1 where a mark was seen and the prediction has none, to and fro so that no mean takes it away."""
    lost = np.isfinite(recording.tracked.positions) & ~np.isfinite(positions)
    return 1.0 * lost * np.where(np.arange(len(positions)) % 2, 1.0, -1.0)[:, None, None]
