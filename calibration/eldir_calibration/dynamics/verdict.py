"""The verdict on a candidate model: the one place that decides whether it fits and what counts as known.

`VERDICTS` is the table. Every row whose condition holds gives its sentence; the last row that holds gives
the verdict. Decisions 0021 and 0025 say why.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from eldir.built.scene import HeldOutNumbers, Identification, IdentifiedModel, ModelNumbers
from eldir.core.records import FloatArray
from eldir_calibration.dynamics._model_check import ModelCheck
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG, IdentificationConfig

_JOINTS = {"pinned": "pinned strips", "clamped": "clamped strips", "hubs": "hubs with sockets"}


class FitVerdict(Enum):
    """Verdict on a candidate model."""

    FITS = "fits"
    NEARLY_RIGHT = "nearly right"
    CHOSEN_BY_FILM = "chosen by the film"
    AT_EDGE = "a parameter at the edge of its range"
    UNDECIDED = "undecided"
    WRONG = "does not fit"

    @property
    def fits(self) -> bool:
        """Whether it is a model of this robot, so that its parameters are physical."""
        return self in (FitVerdict.FITS, FitVerdict.NEARLY_RIGHT, FitVerdict.CHOSEN_BY_FILM)

    @property
    def predicts(self) -> bool:
        """Whether its predictions hold, even where its parameters stand in for something else."""
        return self.fits or self is FitVerdict.AT_EDGE

    @property
    def values_known(self) -> bool:
        """Whether its values are measurements, with the intervals of the fit."""
        return self in (FitVerdict.FITS, FitVerdict.NEARLY_RIGHT)

    def widening(self, config: IdentificationConfig) -> float:
        """Factor by which the intervals of a model that predicts are wider than the fit's."""
        return 1.0 if self is FitVerdict.FITS else config.widening


@dataclass(frozen=True)
class Evidence:
    """Evidence about a candidate model; the verdict depends on nothing else."""

    is_decidable: bool
    """Whether enough frames are left to judge."""
    within_noise: bool
    """Whether its residuals in the fitted films are only noise and divergence."""
    tolerable: bool
    """Whether its residuals in the fitted films and in the held-out cycle are small enough."""
    assumed: bool
    """Whether this is the joint model that was assumed, not one that the film chose."""
    at_edge: tuple[str, ...]
    """Parameters at the edge of their range: they stand in for something that the model lacks."""

    @classmethod
    def of(
        cls,
        shown: ModelCheck,
        held_out: ModelCheck,
        *,
        parts: bool,
        assumed: bool,
        reproducible: bool,
        at_edge: Sequence[str],
        config: IdentificationConfig,
    ) -> Evidence:
        """Evidence from the checks of the fitted films and of the held-out cycle.

        The held-out cycle counts only if slightly perturbed robots agree (`reproducible`). `parts`: every
        part has parameters of its own.
        """
        allowed = max_tolerated_residual(shown, config) if parts else shown.limit
        tolerable = shown.unexplained <= allowed and (
            not reproducible or held_out.unexplained <= config.held_out_factor * allowed
        )
        return cls(shown.is_decidable, shown.unexplained <= shown.limit, tolerable, assumed, tuple(at_edge))

    @classmethod
    def from_numbers(cls, model: ModelNumbers) -> Evidence:
        """Evidence from `model` in a printed scene's results."""
        within = model.unexplained_m <= model.limit_m
        decided, predicts = model.decided, model.predicts
        return cls(decided, within, predicts, model.supposed, model.at_edge)

    @property
    def predicts(self) -> bool:
        """Whether it can be judged and its residuals are small enough."""
        return self.is_decidable and self.tolerable

    @property
    def verdict(self) -> FitVerdict:
        """The last row of `VERDICTS` whose condition holds."""
        return [row.verdict for row in VERDICTS if row.holds(self)][-1]


@dataclass(frozen=True)
class VerdictRow:
    """One line of the table."""

    condition: str
    """Description of the condition."""
    holds: Callable[[Evidence], bool]
    verdict: FitVerdict
    sentence: str
    """Message for the user, with the numbers of `_sentence_values`; empty if there is none."""


VERDICTS: tuple[VerdictRow, ...] = (
    VerdictRow("always", lambda e: True, FitVerdict.FITS, ""),
    VerdictRow(
        "predicts, no parameter at its edge, but leaves more than noise",
        lambda e: e.predicts and not e.at_edge and not e.within_noise,
        FitVerdict.NEARLY_RIGHT,
        "the model is nearly right: noise does not explain {unexplained} mm, {share} of the motion, so "
        "intervals are {widening} times as wide",
    ),
    VerdictRow(
        "predicts, no parameter at its edge, but the film chose the joint model",
        lambda e: e.predicts and not e.at_edge and not e.assumed,
        FitVerdict.CHOSEN_BY_FILM,
        "the film chose {strips}, so no value counts as known: look at the robot's joints, and "
        "measure the spring lengths by hand",
    ),
    VerdictRow(
        "a parameter at its edge",
        lambda e: bool(e.at_edge),
        FitVerdict.AT_EDGE,
        "{at_edge} reached the edge of the allowed range and probably stands in for something that the model "
        "lacks: no value counts as known",
    ),
    VerdictRow(
        "too few frames left",
        lambda e: not e.is_decidable,
        FitVerdict.UNDECIDED,
        "too few frames are left to judge whether the model fits, so no value counts as known: film a gait "
        "in which the robot does not fall",
    ),
    VerdictRow(
        "enough frames left, but leaves too much",
        lambda e: e.is_decidable and not e.tolerable,
        FitVerdict.WRONG,
        "the model does not fit: noise does not explain {unexplained} mm (at most {limit} mm expected), most "
        "in {worst}; no value counts as known, so measure the spring lengths by hand",
    ),
)
"""The table, from harmless to severe."""


def within_noise(check: ModelCheck) -> bool:
    """Whether a prediction can be judged and its residuals are only noise and divergence."""
    return check.is_decidable and check.unexplained <= check.limit


def max_tolerated_residual(check: ModelCheck, config: IdentificationConfig) -> float:
    """Tolerated residual of a model with parameters for every part [m]."""
    return max(check.limit, config.part_tolerance * check.motion)


def parameters_at_edge(names: Sequence[str], z: FloatArray, config: IdentificationConfig) -> list[str]:
    """Parameters as far from nominal as a fit may move them."""
    far = np.abs(z) > config.edge_share * config.z_limit
    return [name for name, edge in zip(names, far, strict=True) if edge]


def is_identified(
    verdict: FitVerdict, prior_share: float, config: IdentificationConfig = DEFAULT_CONFIG
) -> bool:
    """Whether a quantity was identified; `prior_share`: its standard deviation as a part of its prior's."""
    return verdict.values_known and prior_share < config.max_known_spread


def describe_model(model: IdentifiedModel) -> list[str]:
    """Messages about `model` in a printed scene's results: which joint model was taken, what was left out,
    and whether the model fits."""
    sentences, (first, *more) = [], model.tried
    if more:
        extra = ", each strip and spring with its own parameters" if model.parts else ""
        sentences.append(
            f"model: {_JOINTS[model.strips]}{extra}; error in the held-out cycle "
            f"{1e3 * model.held_out_left_m:.2f} mm, with {_JOINTS[first.strips]} and equal parts "
            f"{1e3 * first.held_out_left_m:.2f} mm"
        )
    gaps = enumerate(model.left_out_s, start=1)
    left_out = [f"{t:.0f} s of film {i}" for i, t in gaps if t > DEFAULT_CONFIG.min_reported_gap]
    if left_out:
        sentences.append(
            f"left out: {' and '.join(left_out)}, because slightly perturbed simulations diverge there"
        )
    evidence, facts = Evidence.from_numbers(model), _sentence_values(model)
    return sentences + [
        row.sentence.format(**facts) for row in VERDICTS if row.sentence and row.holds(evidence)
    ]


def describe_doubts(held_out: HeldOutNumbers) -> list[str]:
    """Descriptions of what is predicted badly, from `held_out_cycle` in a printed scene's results: already in
    the cycles that were fitted, so that the next ones will be off, too."""
    if (fitted := held_out.fitted_cycles) is None:  # of a file of version 0.1.0
        return []
    return [
        words.format(error)
        for error, words, limit in (
            (fitted.range_error, "the vertical ranges by up to {:.1%}", DEFAULT_CONFIG.max_range_error),
            (
                fitted.walk_error,
                "the walk by up to {:.2f} body lengths in five cycles",
                DEFAULT_CONFIG.max_walk_error,
            ),
        )
        if error is not None and error > limit
    ]


def describe_predictions(results: Identification) -> list[str]:
    """Messages about predictions, from a printed scene's results: whether they are doubtful, or hold although
    the model does not fit."""
    if doubts := describe_doubts(results.held_out_cycle):
        return [f"predictions are doubtful: in the fitted cycles they miss {' and '.join(doubts)}"]
    fitted = results.held_out_cycle.fitted_cycles
    if results.model.predicts or fitted is None or None in (fitted.range_error, fitted.walk_error):
        return []
    return [
        "the fitted cycles are predicted all the same, the vertical ranges to "
        f"{DEFAULT_CONFIG.max_range_error:.0%}, the walk to {DEFAULT_CONFIG.max_walk_error:g} body lengths "
        "in five cycles; another gait may not be"
    ]


def _sentence_values(model: ModelNumbers) -> dict[str, str]:
    """The numbers in the sentences of the table."""
    motions = [(v, f"{m} {d}") for m, both in model.marks.items() for d, v in both.items()]
    worst = sorted(motions, reverse=True)[: DEFAULT_CONFIG.max_named_motions]
    return {
        "unexplained": f"{1e3 * model.unexplained_m:.2f}",
        "limit": f"{1e3 * model.limit_m:.2f}",
        "share": f"{model.unexplained_m / model.motion_m:.1%}" if model.motion_m else "all",
        "strips": _JOINTS[model.strips],
        "widening": f"{DEFAULT_CONFIG.widening:g}",
        "at_edge": ", ".join(model.at_edge),
        "worst": ", ".join(f"{name} {1e3 * v:.2f} mm" for v, name in worst),
    }
