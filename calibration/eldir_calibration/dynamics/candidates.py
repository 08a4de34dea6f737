"""Candidate models of one robot: the fit of each, and how well it predicts the held-out cycle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from eldir.core.records import FloatArray
from eldir.parameters.printed import Joints
from eldir.parameters.robot import RobotParameters, robot_at
from eldir.parameters.uncertain import PARAMETERS
from eldir_calibration.dynamics.identify import DynamicsFit
from eldir_calibration.dynamics.model_check import ModelCheck, check_model
from eldir_calibration.dynamics.recording import FilmedBody, Recording, predict_marks
from eldir_calibration.dynamics.settings import DEFAULT_SETTINGS, IdentificationSettings
from eldir_calibration.dynamics.verdict import Evidence, FitVerdict, at_edge

_STRIPS: dict[Joints, str] = {"pins": "pinned", "clamped": "clamped", "hubs": "hubs"}


@dataclass(frozen=True)
class CandidateModel:
    """A fit of one joint model of the robot, judged by the films shown and by the held-out cycle."""

    nominal: RobotParameters
    fit: DynamicsFit
    held_out: ModelCheck
    supposed: bool = True
    """Whether this is the joint model that was assumed, not one that the film chose."""
    reproducible: bool = True
    """Whether slightly perturbed robots agree in the cycle before the held-out one."""
    settings: IdentificationSettings = DEFAULT_SETTINGS

    @classmethod
    def of(
        cls,
        body: FilmedBody,
        recording: Recording,
        nominal: RobotParameters,
        fit: DynamicsFit,
        supposed: bool = True,
        settings: IdentificationSettings = DEFAULT_SETTINGS,
    ) -> CandidateModel:
        """A candidate judged by the last cycle of a recording."""
        found = robot_at(body.morphology, nominal, fit.names, fit.z)
        (x,) = predict_marks(body, [recording], [found])[0]
        t = recording.tracked.times
        unseen = np.where(
            (t > recording.end - recording.period)[:, None, None], recording.tracked.positions, np.nan
        )
        later = replace(recording, tracked=replace(recording.tracked, positions=unseen))
        kept = fit.check.kept[-1]
        before = t[: len(kept)] > recording.end - 2 * recording.period
        reproducible = bool(kept[before].mean() > settings.reproducible_share)
        held_out = check_model([later], [x], settings=settings)
        return cls(nominal, fit, held_out, supposed, reproducible, settings)

    @cached_property
    def evidence(self) -> Evidence:
        """The evidence on which the verdict depends."""
        return Evidence.of(
            self.fit.check,
            self.held_out,
            parts=self.parts,
            supposed=self.supposed,
            reproducible=self.reproducible,
            at_edge=at_edge(self.fit.names, self.fit.z, self.settings),
            settings=self.settings,
        )

    @property
    def verdict(self) -> FitVerdict:
        """The verdict on this candidate."""
        return self.evidence.verdict

    @property
    def parts(self) -> bool:
        """Whether every strip and spring has parameters of its own."""
        return any(name not in PARAMETERS for name in self.fit.names)

    def robot(self, body: FilmedBody) -> RobotParameters:
        """The identified robot."""
        return robot_at(body.morphology, self.nominal, self.fit.names, self.fit.z)

    def covariance(self, names: Sequence[str]) -> FloatArray:
        """Covariance of some parameters' normalised values, shape (names, names).

        If the values do not count as known, the covariance is that of the priors, plus the square of the
        distance by which the fit moved each value: a wrong model moves its parameters for wrong reasons.
        """
        if self.verdict.values_known:
            return self.nearby(names)
        return np.diag(1 + self.fit.z[: len(names)] ** 2)

    def nearby(self, names: Sequence[str]) -> FloatArray:
        """Covariance of robots that move like this one, shape (names, names). If the model predicts, these
        robots are near it, even where its parameters stand in for something else."""
        n = len(names)
        if not self.verdict.predicts:
            return self.covariance(names)
        found = self.fit.covariance[:n, :n]
        # Never less sure than the prior.
        wider = np.clip(1 / np.sqrt(np.diag(found)), 1.0, self.verdict.widening(self.settings))
        return found * np.outer(wider, wider)

    def entries(self) -> dict[str, Any]:
        """The entries of `ModelNumbers`."""
        return {
            "strips": _STRIPS[self.nominal.printed.joints],
            "parts": self.parts,
            "supposed": self.supposed,
            "at_edge": self.evidence.at_edge,
            "held_out_left_m": rounded(self.held_out.left),
            "held_out_unexplained_m": rounded(self.held_out.unexplained),
            "fits": self.verdict.fits,
            "predicts": self.verdict.predicts,
            **self.fit.check.entries(),
        }


def rounded(value: float) -> float:
    """The value rounded to six digits, as in the results."""
    return float(f"{value:.6g}")
