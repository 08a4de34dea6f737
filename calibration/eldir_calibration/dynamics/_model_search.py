"""Which models of a robot are fitted, and how well each predicts the held-out cycle.

Cheap models come first, until one explains the films.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from eldir.core.records import FloatArray
from eldir.parameters.printed import Joints
from eldir.parameters.robot import RobotParameters, perturb_robot
from eldir.parameters.uncertain import PARAMETERS
from eldir_calibration.dynamics._fits import DynamicsFit, fit_dynamics, fit_joints, fit_parts
from eldir_calibration.dynamics._model_check import ModelCheck, check_model
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG, IdentificationConfig
from eldir_calibration.dynamics.recording import (
    FilmedBody,
    Measurements,
    Progress,
    Recording,
    predict_markers,
    require_explained,
)
from eldir_calibration.dynamics.verdict import Evidence, FitVerdict, parameters_at_edge, within_noise

_STRIPS: dict[Joints, str] = {"pins": "pinned", "clamped": "clamped", "hubs": "hubs"}


@dataclass(frozen=True)
class CandidateModel:
    """A fit of one joint model of the robot, and its check in the held-out cycle."""

    nominal: RobotParameters
    fit: DynamicsFit
    held_out: ModelCheck
    assumed: bool = True
    """Whether this is the joint model that was assumed, not one that the film chose."""
    reproducible: bool = True
    """Whether slightly perturbed robots agree in the cycle before the held-out one."""
    config: IdentificationConfig = DEFAULT_CONFIG

    @classmethod
    def of(
        cls,
        body: FilmedBody,
        recording: Recording,
        nominal: RobotParameters,
        fit: DynamicsFit,
        assumed: bool = True,
        config: IdentificationConfig = DEFAULT_CONFIG,
    ) -> CandidateModel:
        """A candidate, checked in the last cycle of a recording."""
        robot = perturb_robot(body.morphology, nominal, fit.names, fit.z)
        (x,) = predict_markers(body, [recording], [robot])[0]
        t = recording.tracked.times
        held_out_positions = np.where(
            (t > recording.end - recording.period)[:, None, None], recording.tracked.positions, np.nan
        )
        held_out_recording = replace(
            recording, tracked=replace(recording.tracked, positions=held_out_positions)
        )
        reproducible_frames = fit.check.reproducible[-1]
        before = t[: len(reproducible_frames)] > recording.end - 2 * recording.period
        reproducible = bool(reproducible_frames[before].mean() > config.min_reproducible_share)
        held_out = check_model([held_out_recording], [x], config=config)
        return cls(nominal, fit, held_out, assumed, reproducible, config)

    @cached_property
    def evidence(self) -> Evidence:
        """The evidence on which the verdict depends."""
        return Evidence.of(
            self.fit.check,
            self.held_out,
            parts=self.has_own_parts,
            assumed=self.assumed,
            reproducible=self.reproducible,
            at_edge=parameters_at_edge(self.fit.names, self.fit.z, self.config),
            config=self.config,
        )

    @property
    def verdict(self) -> FitVerdict:
        """The verdict on this candidate."""
        return self.evidence.verdict

    @property
    def has_own_parts(self) -> bool:
        """Whether every strip and spring has parameters of its own."""
        return any(name not in PARAMETERS for name in self.fit.names)

    def robot(self, body: FilmedBody) -> RobotParameters:
        """The identified robot."""
        return perturb_robot(body.morphology, self.nominal, self.fit.names, self.fit.z)

    def covariance(self, names: Sequence[str]) -> FloatArray:
        """Covariance of some parameters' normalised values, shape (names, names).

        If the values do not count as known, the covariance is that of the priors, plus the square of the
        distance by which the fit moved each value: a wrong model moves its parameters for wrong reasons.
        """
        if self.verdict.values_known:
            return self.prediction_covariance(names)
        return np.diag(1 + self.fit.z[: len(names)] ** 2)

    def prediction_covariance(self, names: Sequence[str]) -> FloatArray:
        """Covariance of robots that move like this one, shape (names, names). If the model predicts, these
        robots are near it, even where its parameters stand in for something else."""
        n = len(names)
        if not self.verdict.predicts:
            return self.covariance(names)
        covariance = self.fit.covariance[:n, :n]
        # Never less sure than the prior.
        wider = np.clip(1 / np.sqrt(np.diag(covariance)), 1.0, self.verdict.widening(self.config))
        return covariance * np.outer(wider, wider)

    def entries(self) -> dict[str, Any]:
        """The entries of `ModelNumbers`."""
        return {
            "strips": _STRIPS[self.nominal.printed.joints],
            "parts": self.has_own_parts,
            "supposed": self.assumed,
            "at_edge": self.evidence.at_edge,
            "held_out_left_m": round_number(self.held_out.rms),
            "held_out_unexplained_m": round_number(self.held_out.unexplained),
            "fits": self.verdict.fits,
            "predicts": self.verdict.predicts,
            **self.fit.check.entries(),
        }


def round_number(value: float) -> float:
    """The value rounded to six digits, as in the results."""
    return float(f"{value:.6g}")


@dataclass(frozen=True)
class ModelSearch:
    """Fits models of one robot to all cycles of its films but the last one of the last film."""

    body: FilmedBody
    recordings: Sequence[Recording]
    """All films."""
    names: Sequence[str]
    """Parameters that may change."""
    measurements: Measurements
    seed: int
    progress: Progress
    config: IdentificationConfig

    def models(self, nominal: RobotParameters, others: Sequence[RobotParameters]) -> Iterator[CandidateModel]:
        """Fit one model after the other, the one with the assumed joints (`nominal`) first.

        Other joints are tried in their order until one explains the films. If the residuals of none are only
        noise, every strip and spring gets parameters of its own: with each of the joints that explain about
        as much as the best, until such a model fits and has smaller residuals than all models of equal parts.
        """
        candidates = [self._fit_assumed(nominal)]
        yield candidates[-1]
        for other in others:
            if self._is_explained(candidates):
                break
            candidates.append(self._fit_joints(other, candidates[0].fit))
            yield candidates[-1]
        if any(within_noise(c.fit.check) for c in candidates):
            return
        min_unexplained = min(c.fit.check.unexplained for c in candidates)
        similar = [
            c for c in candidates if c.fit.check.unexplained <= self.config.joint_tolerance * min_unexplained
        ]
        for candidate in similar:
            if candidate.fit.check.is_decidable:
                with_parts = self._fit_parts(candidate)
                yield with_parts
                if with_parts.verdict.fits and with_parts.fit.check.unexplained < min_unexplained:
                    break

    def _is_explained(self, candidates: Sequence[CandidateModel]) -> bool:
        """Whether no further joints are tried: the residuals of the last ones are only noise, or much smaller
        than those of the assumed ones."""
        first, last = candidates[0].fit.check, candidates[-1].fit.check
        gone = last.is_decidable and last.unexplained <= self.config.joint_gain_share * first.unexplained
        return within_noise(last) or (len(candidates) > 1 and gone)

    @property
    def _training_recordings(self) -> list[Recording]:
        *earlier, last = self.recordings
        return [*earlier, last.truncate(last.end - last.period)]

    def _fit_assumed(self, nominal: RobotParameters) -> CandidateModel:
        fit = self._fit_from_starting_points(nominal)
        require_explained(self.recordings, fit.rms[0], self.config)
        return self._evaluate(nominal, fit, True)

    def _fit_joints(self, nominal: RobotParameters, pinned: DynamicsFit) -> CandidateModel:
        """Hubs move nearly as pins do, and cost much more: they need no starting points of their own."""
        if nominal.printed.joints != "hubs":
            return self._evaluate(nominal, self._fit_from_starting_points(nominal), False)
        fit = fit_joints(
            self.body, self._training_recordings, nominal, pinned, self.names,
            measurements=self.measurements, progress=self._prefix_progress("hubs"), config=self.config,
        )  # fmt: skip
        return self._evaluate(nominal, fit, False)

    def _fit_parts(self, candidate: CandidateModel) -> CandidateModel:
        fit = fit_parts(
            self.body, self._training_recordings, candidate.nominal, candidate.fit,
            measurements=self.measurements, progress=self._prefix_progress("parts"), config=self.config,
        )  # fmt: skip
        return self._evaluate(candidate.nominal, fit, candidate.assumed)

    def _fit_from_starting_points(self, nominal: RobotParameters) -> DynamicsFit:
        return fit_dynamics(
            self.body, self._training_recordings, nominal, self.names, measurements=self.measurements,
            seed=self.seed, progress=self._prefix_progress(nominal.printed.joints), config=self.config,
        )  # fmt: skip

    def _evaluate(self, nominal: RobotParameters, fit: DynamicsFit, assumed: bool) -> CandidateModel:
        return CandidateModel.of(self.body, self.recordings[-1], nominal, fit, assumed, self.config)

    def _prefix_progress(self, model: str) -> Progress:
        """Progress that names the model."""
        return lambda what, part: self.progress(f"{model}, {what}", part)
