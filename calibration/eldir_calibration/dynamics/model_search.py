"""Which models of a robot are fitted, and in which order: cheap ones first, until one explains the films."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from eldir.parameters.robot import RobotParameters
from eldir_calibration.dynamics.candidates import CandidateModel
from eldir_calibration.dynamics.identify import DynamicsFit, fit_dynamics, fit_joints, fit_parts
from eldir_calibration.dynamics.least_squares.starting_points import Progress
from eldir_calibration.dynamics.measurements import Measurements
from eldir_calibration.dynamics.recording import FilmedBody, Recording
from eldir_calibration.dynamics.requirements import require_explained
from eldir_calibration.dynamics.settings import IdentificationSettings
from eldir_calibration.dynamics.verdict import within_noise


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
    settings: IdentificationSettings

    def candidates(self, nominal: RobotParameters, others: Sequence[RobotParameters]) -> list[CandidateModel]:
        """All models that were tried, the one with the assumed joints (`nominal`) first.

        Other joints are tried in their order until one explains the films. If the residuals of none are only
        noise, every strip and spring gets parameters of its own: with each of the joints that explain about
        as much as the best, until such a model fits and has smaller residuals than all models of equal parts.
        """
        tried = [self._assumed(nominal)]
        for other in others:
            if self._explained(tried):
                break
            tried.append(self._with_joints(other, tried[0].fit))
        if any(within_noise(c.fit.check) for c in tried):
            return tried
        least = min(c.fit.check.unexplained for c in tried)
        near = [c for c in tried if c.fit.check.unexplained <= self.settings.near_joints * least]
        for equal in near:
            if equal.fit.check.decided:
                tried.append(self._with_parts(equal))
                if tried[-1].verdict.fits and tried[-1].fit.check.unexplained < least:
                    break
        return tried

    def _explained(self, tried: Sequence[CandidateModel]) -> bool:
        """Whether no further joints are worth their time: the last ones leave only noise, or most of what the
        assumed ones left is gone."""
        first, last = tried[0].fit.check, tried[-1].fit.check
        gone = last.decided and last.unexplained <= self.settings.explained_share * first.unexplained
        return within_noise(last) or (len(tried) > 1 and gone)

    @property
    def _shown(self) -> list[Recording]:
        *earlier, last = self.recordings
        return [*earlier, last.until(last.end - last.period)]

    def _assumed(self, nominal: RobotParameters) -> CandidateModel:
        fit = self._from_starting_points(nominal)
        require_explained(self.recordings, fit.left[0], self.settings)
        return self._judged(nominal, fit, True)

    def _with_joints(self, nominal: RobotParameters, pinned: DynamicsFit) -> CandidateModel:
        """Hubs move nearly as pins do, and cost much more: they need no starting points of their own."""
        if nominal.printed.joints != "hubs":
            return self._judged(nominal, self._from_starting_points(nominal), False)
        fit = fit_joints(
            self.body, self._shown, nominal, pinned, self.names,
            measurements=self.measurements, progress=self._called("hubs"), settings=self.settings,
        )  # fmt: skip
        return self._judged(nominal, fit, False)

    def _with_parts(self, equal: CandidateModel) -> CandidateModel:
        fit = fit_parts(
            self.body, self._shown, equal.nominal, equal.fit,
            measurements=self.measurements, progress=self._called("parts"), settings=self.settings,
        )  # fmt: skip
        return self._judged(equal.nominal, fit, equal.supposed)

    def _from_starting_points(self, nominal: RobotParameters) -> DynamicsFit:
        return fit_dynamics(
            self.body, self._shown, nominal, self.names, measurements=self.measurements, seed=self.seed,
            progress=self._called(nominal.printed.joints), settings=self.settings,
        )  # fmt: skip

    def _judged(self, nominal: RobotParameters, fit: DynamicsFit, supposed: bool) -> CandidateModel:
        return CandidateModel.of(self.body, self.recordings[-1], nominal, fit, supposed, self.settings)

    def _called(self, model: str) -> Progress:
        """Progress that names the model."""
        return lambda what, part: self.progress(f"{model}, {what}", part)
