"""A robot identified from films of it: which joint model fits, and each quantity with its interval."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eldir.built.robot import build
from eldir.built.scene import (
    FittedErrors,
    HeldOutNumbers,
    Identification,
    IdentifiedModel,
    IdentifiedQuantity,
    ModelNumbers,
    PrintedScene,
    TrackErrors,
)
from eldir.core.records import FloatArray
from eldir.parameters.robot import QUANTITIES, SPRING_SPREADS, RobotParameters
from eldir.parameters.uncertain import PARAMETERS
from eldir_calibration.dynamics._model_check import CycleMotions
from eldir_calibration.dynamics._model_search import CandidateModel, ModelSearch, round_number
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG, IdentificationConfig
from eldir_calibration.dynamics.recording import (
    NOT_MEASURED,
    FilmedBody,
    Measurements,
    Progress,
    Recording,
    predict_markers,
    require_informative,
)
from eldir_calibration.dynamics.verdict import is_identified

STOPPED = "stopped"
"""Entry of a scene's provenance: the search was ended before all models were tried."""


@dataclass(frozen=True)
class HeldOutCycles:
    """The cycles of a film, of which the last was held out: filmed, without the noise of the tracks, and
    predicted with two robots."""

    tracked: CycleMotions
    before: CycleMotions
    after: CycleMotions
    body_length: float
    """[m]"""

    @property
    def numbers(self) -> HeldOutNumbers:
        """Ranges [m], walks [body lengths per five cycles] and errors."""
        kinds = {"tracked": self.tracked, "before": self.before, "after": self.after}
        errors = {kind: self.tracked.range_errors(kinds[kind]) for kind in ("before", "after")}
        walks = {kind: cycles.per_five_cycles(self.body_length) for kind, cycles in kinds.items()}
        walk_errors = np.abs(walks["after"] - walks["tracked"])
        return HeldOutNumbers(
            {kind: tuple(_round_or_none(v) for v in cycles.ranges[-1]) for kind, cycles in kinds.items()},
            round_number(float(errors["before"][-1])),
            round_number(float(errors["after"][-1])),
            {kind: _round_or_none(w[-1]) for kind, w in walks.items()},
            FittedErrors(
                _round_or_none(_finite_max(errors["after"][:-1])),
                _round_or_none(_finite_max(walk_errors[:-1])),
            ),
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
    config: IdentificationConfig = DEFAULT_CONFIG,
) -> PrintedScene:
    """The parameters `names` of a robot, fitted to all cycles but the last one of the last recording.

    Args:
        recordings: films of one robot, at least two cycles each.
        nominal: the robot as designed, with the assumed joint model.
        others: nominal robots with another joint model, tried where the first leaves more than noise.
        measurements: readings of scales and meters.
        seed: random seed of the starting points; the same seed gives the same result.
        progress: called with the present step and the fraction of it that is done.

    The result is the model that predicts the held-out cycle best, among the models that fit, or among all if
    none fits (`eldir_calibration.dynamics._model_search`). A `KeyboardInterrupt` ends the search: the result
    is then that of the models that were fitted before, and `STOPPED` is in its provenance. Without any model
    it is raised.

    Raises:
        InputError: if the films do not determine the robot, or show a robot of another design.
    """
    require_informative(recordings, config)
    last = recordings[-1]
    search = ModelSearch(body, recordings, names, measurements, seed, progress, config)
    candidates: list[CandidateModel] = []
    provenance = provenance or {}
    try:
        candidates.extend(search.models(nominal, others))
    except KeyboardInterrupt:
        if not candidates:
            raise
        provenance = provenance | {STOPPED: True}
    best = min(candidates, key=lambda c: (not c.verdict.fits, c.held_out.rms))
    robot = best.robot(body)
    strips, springs = part_numbers(robot)
    common = tuple(n for n in best.fit.names if n in PARAMETERS)
    scene = PrintedScene.of(
        robot.uniform.with_parts(strips, springs) if best.has_own_parts else robot,
        common,
        best.prediction_covariance(common),
        np.array([round_number(float(v)) for v in best.fit.z[: len(common)]]),
    )
    return replace(
        scene,
        model_fits=best.verdict.fits,
        results=summarise(best, candidates, body, last, config),
        provenance=provenance,
    )


def held_out_cycle(
    body: FilmedBody, recording: Recording, nominal: RobotParameters, robot: RobotParameters
) -> HeldOutCycles:
    """The cycles of a recording, filmed and predicted with both robots."""
    before, after = predict_markers(body, [recording], [nominal, robot])[0]
    tracked = CycleMotions.of(recording, recording.tracked.positions).without_noise(recording, after)
    predicted = CycleMotions.of(recording, before), CycleMotions.of(recording, after)
    return HeldOutCycles(tracked, *predicted, build(body.morphology).body_length)


def summarise(
    best: CandidateModel,
    candidates: Sequence[CandidateModel],
    body: FilmedBody,
    last: Recording,
    config: IdentificationConfig = DEFAULT_CONFIG,
) -> Identification:
    """The results of the best candidate, rounded, for the reader."""
    fit, nominal = best.fit, best.nominal
    names = [n for n in fit.names if n in PARAMETERS]
    robot, covariance = best.robot(body), best.covariance(names)
    quantities = {}
    for name, quantity in QUANTITIES.items():
        gradient = quantity.gradient(names)
        prior, sd = float(np.sqrt(gradient @ gradient)), float(np.sqrt(gradient @ covariance @ gradient))
        if prior == 0 or quantity.value(nominal) == 0:  # such as friction in sockets of a robot with pins
            continue
        value = quantity.value(robot)
        interval = quantity.interval(value, config.interval * sd)
        quantities[name] = IdentifiedQuantity(
            round_number(value),
            quantity.unit,
            (round_number(interval[0]), round_number(interval[1])),
            round_number(quantity.value(nominal)),
            round_number(sd / prior),
            is_identified(best.verdict, sd / prior, config),
        )
    return Identification(
        IdentifiedModel(**best.entries(), tried=tuple(ModelNumbers(**c.entries()) for c in candidates)),
        quantities,
        tuple(n for n, q in quantities.items() if not q.identified),
        TrackErrors(*map(round_number, fit.rms)),
        TrackErrors(*map(round_number, fit.noise)),
        held_out_cycle(body, last, nominal, robot).numbers,
        sum(c.fit.evaluations for c in candidates),
        {n: tuple(values) for n, values in part_numbers(robot)[1].items()} if best.has_own_parts else None,
    )


def _round_or_none(value: float) -> float | None:
    """For JSON; None where the camera saw too little."""
    return round_number(float(value)) if np.isfinite(value) else None


def _finite_max(values: FloatArray) -> float:
    return float(values[np.isfinite(values)].max(initial=-np.inf))


def part_numbers(robot: RobotParameters) -> tuple[FloatArray, dict[str, list[float]]]:
    """Real minus designed lengths of the strips [m], in the design's order, and the quantities of each
    motor's spring."""
    own = robot.motor_springs(robot.motor_z.shape[1])
    springs = {n: [round_number(getattr(s, QUANTITIES[n].field)) for s in own] for n in SPRING_SPREADS}
    return np.array([round_number(v) for v in robot.strips.tolist()]), springs
