"""A robot identified from films of it: which joint model fits, and each quantity with its interval."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eldir.built.robot import build
from eldir.built.scene import (
    BuiltScene,
    FittedErrors,
    HeldOutNumbers,
    Identification,
    IdentifiedModel,
    IdentifiedQuantity,
    ModelNumbers,
    TrackErrors,
)
from eldir.core.records import FloatArray
from eldir.parameters.robot import QUANTITIES, SPRING_SPREADS, RobotParameters
from eldir.parameters.uncertain import PARAMETERS
from eldir_calibration.dynamics.candidates import CandidateModel, rounded
from eldir_calibration.dynamics.cycles import Cycles
from eldir_calibration.dynamics.least_squares.starting_points import Progress
from eldir_calibration.dynamics.measurements import NOT_MEASURED, Measurements
from eldir_calibration.dynamics.model_search import ModelSearch
from eldir_calibration.dynamics.recording import FilmedBody, Recording, predict_marks
from eldir_calibration.dynamics.requirements import require_informative
from eldir_calibration.dynamics.settings import DEFAULT_SETTINGS, IdentificationSettings
from eldir_calibration.dynamics.verdict import is_known


@dataclass(frozen=True)
class HeldOut:
    """The cycles of a film, of which the last was held out: filmed, without the noise of the tracks, and
    predicted with two robots."""

    tracked: Cycles
    before: Cycles
    after: Cycles
    body_length: float
    """[m]"""

    @property
    def numbers(self) -> HeldOutNumbers:
        """Ranges [m], walks [body lengths per five cycles] and errors."""
        kinds = {"tracked": self.tracked, "before": self.before, "after": self.after}
        errors = {kind: self.tracked.range_errors(kinds[kind]) for kind in ("before", "after")}
        walks = {kind: cycles.per_five_cycles(self.body_length) for kind, cycles in kinds.items()}
        astray = np.abs(walks["after"] - walks["tracked"])
        return HeldOutNumbers(
            {kind: tuple(_value(v) for v in cycles.ranges[-1]) for kind, cycles in kinds.items()},
            rounded(float(errors["before"][-1])),
            rounded(float(errors["after"][-1])),
            {kind: _value(w[-1]) for kind, w in walks.items()},
            FittedErrors(_value(_largest(errors["after"][:-1])), _value(_largest(astray[:-1]))),
        )


def identify_robot(
    body: FilmedBody,
    recordings: Sequence[Recording],
    nominal: RobotParameters,
    *,
    others: Sequence[RobotParameters] = (),
    measurements: Measurements = NOT_MEASURED,
    names: Sequence[str] = tuple(PARAMETERS),
    seed: int = 0,
    progress: Progress = lambda what, part: None,
    provenance: dict[str, Any] | None = None,
    settings: IdentificationSettings = DEFAULT_SETTINGS,
) -> BuiltScene:
    """The parameters `names` of a robot, fitted to all cycles but the last one of the last recording.

    Args:
        recordings: films of one robot, at least two cycles each.
        nominal: the robot as drawn, with the assumed joint model.
        others: nominal robots with another joint model, tried where the first leaves more than noise.
        measurements: readings of scales and meters.
        seed: random seed of the starting points; the same seed gives the same result.
        progress: called with the present step and the fraction of it that is done.

    The result is the model that predicts the held-out cycle best, among the models that fit, or among all if
    none fits (`eldir_calibration.dynamics.model_search`).

    Raises:
        InputError: if the films do not determine the robot, or show a robot of another design.
    """
    require_informative(recordings, settings)
    last = recordings[-1]
    search = ModelSearch(body, recordings, names, measurements, seed, progress, settings)
    tried = search.candidates(nominal, others)
    best = min(tried, key=lambda c: (not c.verdict.fits, c.held_out.left))
    found = best.robot(body)
    strips, springs = _parts(found)
    common = tuple(n for n in best.fit.names if n in PARAMETERS)
    return BuiltScene.of(
        found.uniform.with_parts(strips, springs) if best.parts else found,
        common,
        best.nearby(common),
        np.array([rounded(float(v)) for v in best.fit.z[: len(common)]]),
        best.verdict.fits,
        results=results(best, tried, body, last, settings),
        provenance=provenance or {},
    )


def held_out_cycle(
    body: FilmedBody, recording: Recording, nominal: RobotParameters, found: RobotParameters
) -> HeldOut:
    """The cycles of a recording, filmed and predicted with both robots."""
    before, after = predict_marks(body, [recording], [nominal, found])[0]
    tracked = Cycles.of(recording, recording.tracked.positions).without_noise(recording, after)
    predicted = Cycles.of(recording, before), Cycles.of(recording, after)
    return HeldOut(tracked, *predicted, build(body.morphology).body_length)


def results(
    best: CandidateModel,
    tried: Sequence[CandidateModel],
    body: FilmedBody,
    last: Recording,
    settings: IdentificationSettings = DEFAULT_SETTINGS,
) -> Identification:
    """The results of the best candidate, rounded, for the reader."""
    fit, nominal = best.fit, best.nominal
    names = [n for n in fit.names if n in PARAMETERS]
    whole, covariance = best.robot(body), best.covariance(names)
    quantities = {}
    for name, quantity in QUANTITIES.items():
        by = quantity.slopes(names)
        prior, sd = float(np.sqrt(by @ by)), float(np.sqrt(by @ covariance @ by))
        if prior == 0 or quantity.value(nominal) == 0:  # such as friction in sockets of a robot with pins
            continue
        value, away = quantity.value(whole), settings.interval * sd
        interval = [value - away, value + away] if quantity.additive else list(value * np.exp([-away, away]))
        quantities[name] = IdentifiedQuantity(
            rounded(value),
            quantity.unit,
            (rounded(interval[0]), rounded(interval[1])),
            rounded(quantity.value(nominal)),
            rounded(sd / prior),
            is_known(best.verdict, sd / prior, settings),
        )
    return Identification(
        IdentifiedModel(**best.entries(), tried=tuple(ModelNumbers(**c.entries()) for c in tried)),
        quantities,
        tuple(n for n, q in quantities.items() if not q.identified),
        TrackErrors(*map(rounded, fit.left)),
        TrackErrors(*map(rounded, fit.noise)),
        held_out_cycle(body, last, nominal, whole).numbers,
        sum(c.fit.evaluations for c in tried),
        {n: tuple(values) for n, values in _parts(whole)[1].items()} if best.parts else None,
    )


def _value(value: float) -> float | None:
    """For JSON; None where the camera saw too little."""
    return rounded(float(value)) if np.isfinite(value) else None


def _largest(values: FloatArray) -> float:
    return float(values[np.isfinite(values)].max(initial=-np.inf))


def _parts(whole: RobotParameters) -> tuple[FloatArray, dict[str, list[float]]]:
    """Real minus drawn lengths of the strips [m], in the design's order, and the quantities of each motor's
    spring."""
    own = whole.springs_of(whole.motor_z.shape[1])
    springs = {n: [rounded(getattr(s, QUANTITIES[n].field)) for s in own] for n in SPRING_SPREADS}
    return np.array([rounded(v) for v in whole.strips.tolist()]), springs
