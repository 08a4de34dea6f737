"""An identification as a least-squares problem: the compared quantities and their scales.

A problem is fixed and has no state: the same question gives the same answer. What an optimiser asks for
repeatedly, and how often it did, is kept by `eldir_calibration.dynamics.least_squares.evaluation.Evaluator`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eldir.core.records import FloatArray
from eldir.parameters.robot import RobotParameters, robot_at
from eldir.parameters.uncertain import is_unobservable
from eldir_calibration.dynamics.least_squares.linearisation import Linearisation, linearise
from eldir_calibration.dynamics.least_squares.residuals import Residual, residual
from eldir_calibration.dynamics.measurements import NOT_MEASURED, Measurements
from eldir_calibration.dynamics.recording import FilmedBody, Recording, predict_marks
from eldir_calibration.dynamics.settings import DEFAULT_SETTINGS, IdentificationSettings


@dataclass(frozen=True, eq=False)
class Problem:
    """Recordings of one robot, the parameters that may change, and the scale of every residual."""

    body: FilmedBody
    recordings: Sequence[Recording]
    nominal: RobotParameters
    names: Sequence[str]
    """Names of the P parameters."""
    noise: tuple[float, float]
    """Standard deviations of the residuals of shape, and of walk per second [m]."""
    step_widths: FloatArray
    """Steps of z for slopes, to both sides, shape (P,)."""
    measurements: Measurements = NOT_MEASURED
    settings: IdentificationSettings = DEFAULT_SETTINGS

    def positions(self, z: FloatArray) -> list[FloatArray]:
        """Predicted marks at parameter values `z` [m], of each recording, shape (frames, marks, 2)."""
        return [x[0] for x in self._motions([z])]

    def linearise(self, z: FloatArray) -> Linearisation:
        """The predicted motion at `z`, and its slopes."""
        return linearise(
            self.body, self.recordings, self.nominal, self.names, z, self.step_widths, self.settings
        )

    def residuals(self, z: FloatArray, positions: Sequence[FloatArray]) -> FloatArray:
        """Residuals of tracks, priors and readings in standard deviations, shape (values,); `positions` are
        those predicted at `z`."""
        return np.concatenate([self._scaled(self.track_residuals(positions)), self._known(z)])

    def jacobian(self, z: FloatArray, linear: Linearisation) -> FloatArray:
        """Derivatives of `residuals` by z, shape (values, P); `linear` is the linearisation at `z`."""
        moved = [residual(r, -s) for r, s in zip(self.recordings, linear.slopes, strict=True)]
        return np.concatenate([self._scaled(moved).T, self.known_slopes(z)])

    def track_residuals(self, positions: Sequence[FloatArray]) -> list[Residual]:
        """Residual of a prediction of each recording; huge where a robot blew up."""
        huge = self.settings.lost_residual * self.noise[0]
        return [
            residual(r, np.nan_to_num(r.tracked.positions - x, nan=0.0) + huge * _lost(r, x))
            for r, x in zip(self.recordings, positions, strict=True)
        ]

    def divergence(self, z: FloatArray, linear: Linearisation) -> list[Residual]:
        """Deviation of slightly perturbed robots from the linearisation at `z`, shapes (n, ...).

        It has two causes: feet land differently, and the motion is not linear.
        """
        signs = np.random.default_rng(len(z)).choice([-1.0, 1.0], (self.settings.perturbed, len(z)))
        observable = [not is_unobservable(n) for n in self.names]
        off = self.settings.perturbation * signs * self.step_widths * observable
        motions = self._motions([z, *(z + off)])
        return [
            residual(r, np.nan_to_num(x[1:] - x[0] - np.tensordot(off, slopes, 1)))
            for r, x, slopes in zip(self.recordings, motions, linear.slopes, strict=True)
        ]

    def known_slopes(self, z: FloatArray) -> FloatArray:
        """Derivatives by z of the residuals of priors and readings, shape (priors and readings, P)."""
        h = self.settings.known_step
        steps = h * np.eye(len(z))
        return np.stack([(self._known(z + s) - self._known(z - s)) / (2 * h) for s in steps], axis=1)

    def _motions(self, points: Sequence[FloatArray]) -> list[FloatArray]:
        """Predicted marks of each recording [m], shape (points, frames, marks, 2)."""
        tried = [robot_at(self.body.morphology, self.nominal, self.names, z) for z in points]
        return predict_marks(self.body, self.recordings, tried)

    def _known(self, z: FloatArray) -> FloatArray:
        """How far priors and readings are from `z`, in standard deviations."""
        if self.measurements == NOT_MEASURED:
            return z
        robot = robot_at(self.body.morphology, self.nominal, self.names, z)
        return np.append(z, self.measurements.residuals(self.body, robot, self.settings))

    def _scaled(self, residuals: Sequence[Residual]) -> FloatArray:
        return np.concatenate([r.scaled(*self.noise) for r in residuals], axis=-1)


def _lost(recording: Recording, positions: FloatArray) -> FloatArray:
    """1 where a mark was seen and the prediction has none, alternating in sign so that no mean removes it."""
    lost = np.isfinite(recording.tracked.positions) & ~np.isfinite(positions)
    return 1.0 * lost * np.where(np.arange(len(positions)) % 2, 1.0, -1.0)[:, None, None]
