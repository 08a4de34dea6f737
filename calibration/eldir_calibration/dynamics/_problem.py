"""An identification as a least-squares problem: residuals, their scales and their derivatives.

A problem is fixed and has no state: the same question gives the same answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eldir.core.records import FloatArray
from eldir.parameters.robot import RobotParameters, perturb_robot
from eldir.parameters.uncertain import is_unobservable
from eldir_calibration.dynamics._residuals import Residual, compute_residual
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG, IdentificationConfig
from eldir_calibration.dynamics.recording import (
    NOT_MEASURED,
    FilmedBody,
    Measurements,
    Recording,
    predict_markers,
)


@dataclass(frozen=True)
class Linearisation:
    """A predicted motion and its tangents at one point.

    Tangents are central differences over a finite step of each parameter. The engine's own derivatives
    (`eldir.built.sensitivities`) are exact, but grow without bound where feet strike the ground: a landing's
    outcome depends on the last micrometre, while the motion as a whole hardly changes. A fit needs the
    tangent of the whole motion, over a step that is wide against that
    (docs/decisions/0021-identification.md).
    """

    positions: list[FloatArray]
    """Markers in each recording [m], shape (frames, markers, 2)."""
    tangents: list[FloatArray]
    """Tangents of each recording [m per standard deviation of the prior],
    shape (parameters, frames, markers, 2)."""
    divergence: list[FloatArray]
    """Deviation of slightly perturbed robots from the linear prediction in each recording, by diverging
    landings [m], shape (n, frames, markers, 2)."""


def linearise(
    body: FilmedBody,
    recordings: Sequence[Recording],
    nominal: RobotParameters,
    names: Sequence[str],
    z: FloatArray,
    step_widths: FloatArray,
    config: IdentificationConfig = DEFAULT_CONFIG,
) -> Linearisation:
    """Linearisation at normalised values `z`, over `step_widths` to both sides, shapes (parameters,)."""
    observable = [j for j, name in enumerate(names) if not is_unobservable(name)]
    units = np.eye(len(z))[observable]
    sides = [
        z + sign * width * unit
        for width, unit in zip(step_widths[observable], units, strict=True)
        for sign in (1, -1)
    ]
    copies = config.jitter_robots
    signs = np.random.default_rng(len(z)).choice([-1.0, 1.0], (copies, len(z)))
    jitter = config.jitter * signs * step_widths * units.sum(axis=0)
    robots = [perturb_robot(body.morphology, nominal, names, p) for p in [z, *(z + jitter), *sides]]
    motions = predict_markers(body, recordings, robots)
    width = step_widths[observable, None, None, None]
    tangents = []
    for x in motions:
        here, above, below = x[:1], x[1 + copies :: 2], x[2 + copies :: 2]
        tangent = (above - below) / (2 * width)
        # Where one side fell over, the other side still has a tangent.
        tangent = np.where(np.isfinite(tangent), tangent, (above - here) / width)
        tangent = np.where(np.isfinite(tangent), tangent, (here - below) / width)
        whole = np.zeros((len(z), *tangent.shape[1:]))
        whole[observable] = np.nan_to_num(tangent)
        tangents.append(whole)
    divergence = [
        np.nan_to_num(x[1 : 1 + copies] - x[0] - np.tensordot(jitter, whole, 1))
        for x, whole in zip(motions, tangents, strict=True)
    ]
    return Linearisation([x[0] for x in motions], tangents, divergence)


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
    """Steps of z for the tangents, to both sides, shape (P,)."""
    measurements: Measurements = NOT_MEASURED
    config: IdentificationConfig = DEFAULT_CONFIG

    def positions(self, z: FloatArray) -> list[FloatArray]:
        """Predicted markers at parameter values `z` [m], of each recording, shape (frames, markers, 2)."""
        return [x[0] for x in self._predict([z])]

    def linearise(self, z: FloatArray) -> Linearisation:
        """The predicted motion at `z`, and its tangents."""
        return linearise(
            self.body, self.recordings, self.nominal, self.names, z, self.step_widths, self.config
        )

    def residuals(self, z: FloatArray, positions: Sequence[FloatArray]) -> FloatArray:
        """Residuals of tracks, priors and readings in standard deviations, shape (values,); `positions` are
        those predicted at `z`."""
        return np.concatenate([self._scaled(self.track_residuals(positions)), self._prior_residuals(z)])

    def jacobian(self, z: FloatArray, linear: Linearisation) -> FloatArray:
        """Derivatives of `residuals` by z, shape (values, P); `linear` is the linearisation at `z`."""
        changes = [compute_residual(r, -s) for r, s in zip(self.recordings, linear.tangents, strict=True)]
        return np.concatenate([self._scaled(changes).T, self.prior_jacobian(z)])

    def track_residuals(self, positions: Sequence[FloatArray]) -> list[Residual]:
        """Residual of a prediction of each recording; huge where a robot blew up."""
        huge = self.config.diverged_residual * self.noise[0]
        return [
            compute_residual(
                r, np.nan_to_num(r.tracked.positions - x, nan=0.0) + huge * _diverged_frames(r, x)
            )
            for r, x in zip(self.recordings, positions, strict=True)
        ]

    def divergence(self, z: FloatArray, linear: Linearisation) -> list[Residual]:
        """Deviation of slightly perturbed robots from the linearisation at `z`, shapes (n, ...).

        It has two causes: feet land differently, and the motion is not linear.
        """
        signs = np.random.default_rng(len(z)).choice([-1.0, 1.0], (self.config.perturbed_robots, len(z)))
        observable = [not is_unobservable(n) for n in self.names]
        perturbations = self.config.perturbation * signs * self.step_widths * observable
        motions = self._predict([z, *(z + perturbations)])
        return [
            compute_residual(r, np.nan_to_num(x[1:] - x[0] - np.tensordot(perturbations, tangents, 1)))
            for r, x, tangents in zip(self.recordings, motions, linear.tangents, strict=True)
        ]

    def prior_jacobian(self, z: FloatArray) -> FloatArray:
        """Derivatives by z of the residuals of priors and readings, shape (priors and readings, P)."""
        h = self.config.prior_step
        steps = h * np.eye(len(z))
        return np.stack(
            [(self._prior_residuals(z + s) - self._prior_residuals(z - s)) / (2 * h) for s in steps], axis=1
        )

    def _predict(self, points: Sequence[FloatArray]) -> list[FloatArray]:
        """Predicted markers of each recording [m], shape (points, frames, markers, 2)."""
        robots = [perturb_robot(self.body.morphology, self.nominal, self.names, z) for z in points]
        return predict_markers(self.body, self.recordings, robots)

    def _prior_residuals(self, z: FloatArray) -> FloatArray:
        """Residuals of priors and readings at `z`, in standard deviations, shape (priors and readings,)."""
        if self.measurements == NOT_MEASURED:
            return z
        robot = perturb_robot(self.body.morphology, self.nominal, self.names, z)
        return np.append(z, self.measurements.residuals(self.body, robot, self.config))

    def _scaled(self, residuals: Sequence[Residual]) -> FloatArray:
        return np.concatenate([r.scale(*self.noise) for r in residuals], axis=-1)


def _diverged_frames(recording: Recording, positions: FloatArray) -> FloatArray:
    """1 where a marker was visible and the prediction diverged, alternating in sign so that no mean removes
    it."""
    lost = np.isfinite(recording.tracked.positions) & ~np.isfinite(positions)
    return 1.0 * lost * np.where(np.arange(len(positions)) % 2, 1.0, -1.0)[:, None, None]
