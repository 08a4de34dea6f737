"""What is believed of a robot after its films, within a minute: an ensemble of robots that may be it.

Unlike the fit of `eldir_calibration.dynamics.results`, no derivatives are needed, the robots are coarse ones,
and no joint model is selected: masses are joined by hubs. Parameters are those of identification and the
differences between the springs of the motors; strips keep their drawn lengths.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eldir.built.scene import PrintedScene
from eldir.core.records import BoolArray, FloatArray, Record
from eldir.errors import InputError
from eldir.parameters.robot import RobotParameters, part_names, perturb_robot
from eldir.parameters.uncertain import PARAMETERS, applicable_parameters
from eldir_calibration.dynamics._ensemble import next_share, update
from eldir_calibration.dynamics._problem import compute_residual
from eldir_calibration.dynamics.recording import (
    NOT_MEASURED,
    FilmedBody,
    Measurements,
    Progress,
    Recording,
    predict_markers,
)


@dataclass(frozen=True)
class BeliefConfig:
    """Numbers of a belief. The errors are those of coarse robots and of a model that is not the filmed robot,
    not of the camera."""

    members: int = 64
    """Robots of the ensemble: eight groups of the engine's lanes."""
    max_steps: int = 6
    """Steps in which the films enter at most."""
    shape_error: float = 3e-3
    """Standard deviation of the shape's residuals [m]."""
    walk_error: float = 3e-3
    """Standard deviation of the residuals of the walk in a second [m]."""
    correlation_time: float = 3.0
    """Residuals within this time count as one [s]: half of a pulse."""
    max_z: float = 4.0
    """Members keep within so many standard deviations of the prior."""
    min_stroke: float = 2e-3
    """Members have springs with at least this stroke [m]."""


@dataclass(frozen=True, eq=False)
class Belief(Record):
    """Robots that may be the filmed one: N members with P parameters."""

    nominal: RobotParameters
    """The robot of which the parameters are deviations."""
    body: FilmedBody
    names: tuple[str, ...]
    """Names of the parameters."""
    z: FloatArray
    """Members, in standard deviations of the parameters' priors, shape (N, P)."""
    misfit: float
    """Mean square of the residuals, in standard deviations: about 1 or less where the ensemble explains the
    films."""

    @property
    def explains(self) -> bool:
        """Whether the members move as the films show, within the assumed errors."""
        return self.misfit <= 1.0

    @property
    def scene(self) -> PrintedScene:
        """The belief as gait, shortlist and report read it: the mean robot with the covariance of its
        parameters, which is widened where the members do not explain the films."""
        common = [n for n in self.names if n in PARAMETERS]
        z = self.z[:, : len(common)]
        covariance = np.cov(z.T) * max(1.0, self.misfit)
        mean = self.z.mean(axis=0)
        robot = perturb_robot(self.body.morphology, self.nominal, self.names, mean)
        scene = PrintedScene.of(robot, common, (covariance + covariance.T) / 2, mean[: len(common)])
        return replace(scene, model_fits=self.explains)


def believe(
    body: FilmedBody,
    recordings: Sequence[Recording],
    nominal: RobotParameters,
    *,
    filmed: Sequence[RobotParameters] | None = None,
    measurements: Measurements = NOT_MEASURED,
    known: Collection[str] = (),
    prior: PrintedScene | None = None,
    seed: int = 0,
    progress: Progress = lambda what, part: None,
    config: BeliefConfig = BeliefConfig(),  # frozen
) -> Belief:
    """The belief after all `recordings` of one robot, from the priors, which are all that is known without
    any; the same films and seed give the same one.

    Args:
        nominal: the robot as designed, with hubs, on the present supply.
        filmed: the same at each recording, where the supply was another one.
        measurements: readings during the last recording.
        known: parameters that keep their nominal values, because they were measured.
        prior: what is known of the common parameters before the films; else their priors.
        progress: called before each step.

    Raises:
        InputError: if hardly any robot of this design keeps moving.
    """
    names = (
        *(n for n in applicable_parameters(nominal.printed) if n not in known),
        *(n for n in part_names(body.morphology) if n.startswith("spring")),
    )
    rng = np.random.default_rng([seed, len(recordings)])
    ensemble = _Ensemble(
        body, recordings, filmed or [nominal] * max(len(recordings), 1), names, measurements, config
    )
    z, used = _sample_prior(names, prior, config.members, rng), 0.0
    for step in range(config.max_steps + 1):
        residuals, valid = ensemble.predict(z)
        if valid.sum() < config.members / 4:
            raise InputError(
                "no robot of this design moves like the one that was filmed",
                code="dynamics.unexplained",
                expected=f"{config.members // 4} of {config.members} simulated robots that keep moving",
                found=str(valid.sum()),
                remedy="check the design file, the order of the markers and the wiring",
            )
        squares = (residuals[valid] ** 2).sum(axis=1)
        progress("fitting robots to the films", used)
        if not recordings or used >= 1.0 or step == config.max_steps:
            break
        last = step == config.max_steps - 1
        share = 1.0 - used if last else next_share(squares, ensemble.data, 1.0 - used)
        kept = update(z[valid], residuals[valid], share, rng)
        z = np.clip(_refill(kept, config.members, rng), -config.max_z, config.max_z)
        used += share
    return Belief(nominal, body, names, z[valid], float(squares.mean() / max(ensemble.data, 1.0)))


def _sample_prior(
    names: Sequence[str], prior: PrintedScene | None, members: int, rng: np.random.Generator
) -> FloatArray:
    """Members before the films, shape (N, P)."""
    z = rng.standard_normal((members, len(names)))
    if prior is None:
        return z
    known = [names.index(name) for name in prior.parameters]
    root = np.linalg.cholesky(prior.covariance)
    z[:, known] = prior.z + np.einsum("nj,ij->ni", z[:, known], root)
    return z


def _refill(z: FloatArray, members: int, rng: np.random.Generator) -> FloatArray:
    """The members, and as many new ones with their mean and covariance as were lost."""
    lost = members - len(z)
    if not lost:
        return z
    return np.concatenate([z, rng.multivariate_normal(z.mean(axis=0), np.cov(z.T), lost)])


@dataclass(frozen=True, eq=False)
class _Ensemble:
    """Predictions of members, compared with the films and readings."""

    body: FilmedBody
    recordings: Sequence[Recording]
    nominal: Sequence[RobotParameters]
    """The nominal robot at each recording."""
    names: tuple[str, ...]
    measurements: Measurements
    config: BeliefConfig

    @property
    def data(self) -> float:
        """Number of independent data in the films and readings."""
        found = 0.0
        for r in self.recordings:
            seen = np.isfinite(r.tracked.positions).sum()
            found += seen * self._interval(r) / self.config.correlation_time
            found += np.ptp(r.tracked.times) / self.config.correlation_time
        return found + len(self.measurements.residuals(self.body, self.nominal[-1]))

    def predict(self, z: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Residuals of the members, shape (N, D), and which of them moved to the end, shape (N,)."""
        valid = np.array([self._has_stroke(self._robot(-1, one)) for one in z])
        parts = []
        for i, recording in enumerate(self.recordings):
            robots = [self._robot(i, one if good else 0 * one) for one, good in zip(z, valid, strict=True)]
            (x,) = predict_markers(self.body, [recording], robots, coarse=True)
            valid &= np.isfinite(x).all(axis=(1, 2, 3))
            parts.append(self._residual(recording, np.where(valid[:, None, None, None], x, 0.0)))
        read = [self.measurements.residuals(self.body, self._robot(-1, one)) for one in z]
        return np.concatenate([*parts, np.array(read)], axis=1), valid

    def _robot(self, recording: int, z: FloatArray) -> RobotParameters:
        """A member at a recording."""
        return perturb_robot(self.body.morphology, self.nominal[recording], self.names, z)

    def _residual(self, recording: Recording, predicted: FloatArray) -> FloatArray:
        """Residuals of each member, scaled so that those within the correlation time count as one."""
        config = self.config
        frames = np.sqrt(max(1.0, config.correlation_time / self._interval(recording)))
        seconds = np.sqrt(max(1.0, config.correlation_time))
        residual = compute_residual(recording, recording.tracked.positions - predicted)
        return residual.scale(config.shape_error * frames, config.walk_error * seconds)

    def _has_stroke(self, robot: RobotParameters) -> bool:
        springs = (robot.springs, *robot.motor_springs(self.body.morphology.motors))
        return all(s.hot_length - s.cold_length > self.config.min_stroke for s in springs)

    @staticmethod
    def _interval(recording: Recording) -> float:
        """Time between frames [s]."""
        return float(np.median(np.diff(recording.tracked.times)))
