"""The printed robot as identified from films, with its uncertainty. JSON "eldir-built-scene/2"."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, field, fields, replace
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, NonNegativeFloat

from eldir.built.gait import FilmedGait
from eldir.core.arguments import require_known, require_shape, require_value
from eldir.core.records import OMITTED, Array, FileRecord, FloatArray, Record, record
from eldir.core.validation import validate
from eldir.design import Design
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SUPPLY, SpringParameters
from eldir.parameters.uncertain import PARAMETERS

_MAX_Z = 30.0  # standard deviations of a prior; a fit ends at four
_MAX_STRIP_M = 0.05  # length of a strip beyond the drawing [m]; the pitch is 0.057
_MAX_FACTOR = 100.0  # times the nominal value, or a part of it
_SUPPLY_AND_AIR = (*SUPPLY, "ambient", "convection_still")
"""Fields of springs that a rig and its air determine; still air takes more heat where it is warmer."""
_SAME = 1e-4  # relative: files have z to six digits
_FIRST_KEYS = {"strained": "at_edge", "doubt_left_of_prior": "spread_left_of_prior"}

Numbers = Annotated[FloatArray, Array("f8", None)]


@record
class ModelNumbers(Record):
    """One joint model of the robot and its fit. fits: the residual is noise alone, or at most 2 % of the
    motion if every part has its own parameters."""

    strips: Literal["pinned", "clamped", "hubs"]
    """How the masses join the strips: by pins, by clamping hexagons, or by hubs with sockets."""
    parts: bool
    """Whether every strip and spring has parameters of its own."""
    supposed: bool
    """Whether the joint model was given by the user, not selected by the film."""
    at_edge: tuple[str, ...]
    """Parameters at the edge of the range that a fit allows. If there are any, the model does not count as
    fitting."""
    held_out_left_m: float
    """Root mean square residual in the held-out cycle [m]."""
    held_out_unexplained_m: NonNegativeFloat
    """Root mean square residual in the held-out cycle that noise does not explain [m]."""
    fits: bool
    """Whether the model fits: the residual is noise alone, or small, and no parameter is at the edge of its
    range."""
    decided: bool
    """False: the motion becomes chaotic, by landings, too early to decide whether the model fits."""
    left_out_s: tuple[NonNegativeFloat, ...]
    """Time of each film that is left out, because slightly perturbed simulations diverge there [s]."""
    unexplained_m: NonNegativeFloat
    """Root mean square residual that noise does not explain [m]."""
    limit_m: NonNegativeFloat
    """Largest unexplained_m with which the model fits [m]."""
    motion_m: NonNegativeFloat
    """Root mean square motion of the markers [m]."""
    noise_m: NonNegativeFloat
    """Noise of the tracks [m]."""
    marks: dict[str, dict[str, NonNegativeFloat]]
    """Residual of each mark that was seen, forward and up, that noise does not explain [m]."""
    predicts: bool
    """The same as fits, but parameters may be at the edge of their range."""


@record
class IdentifiedModel(ModelNumbers):
    """The joint model that was taken, and all that were tried."""

    tried: Annotated[tuple[ModelNumbers, ...], Field(min_length=1)]
    """Every joint model that was tried."""


@record
class IdentifiedQuantity(Record):
    """A physical quantity of the robot, with its uncertainty."""

    value: float
    """The most probable value, in `unit`."""
    unit: str
    """Unit of the value."""
    interval: tuple[float, float]
    """95 % interval of the value, low and high, in `unit`."""
    nominal: float
    """Value of the robot as drawn, in `unit`."""
    of_prior: NonNegativeFloat
    """Standard deviation after the films, as a part of that before."""
    identified: bool
    """Whether the films determine the quantity."""


@record
class TrackErrors(Record):
    """Errors of the markers' shape and of the walk."""

    shape: NonNegativeFloat
    """Error of the markers' shape [m]."""
    walk_per_second: NonNegativeFloat
    """Error of the walk per second [m]."""


@record
class FittedErrors(Record):
    """Largest errors of the identified robot in the cycles that were fitted; null where nothing was seen."""

    range_error: NonNegativeFloat | None
    """Error of the vertical ranges, relative to the filmed ones."""
    walk_error: NonNegativeFloat | None
    """Error of the walk [body lengths per five cycles]."""


@record
class HeldOutNumbers(Record):
    """The last cycle of the last film, which was not fitted (tracked), beside the predictions of the nominal
    robot (before) and the identified one (after)."""

    vertical_range_m: dict[str, tuple[float | None, ...]]
    """Vertical range of each mark, tracked, before and after [m]; null where the mark was not seen."""
    error_before: NonNegativeFloat
    """Mean error of the nominal robot's ranges, relative to the mean filmed range."""
    error_after: NonNegativeFloat
    """Mean error of the identified robot's ranges, relative to the mean filmed range."""
    walk: Annotated[dict[str, float | None] | None, OMITTED] = None
    """Walk in that cycle, tracked, before and after [body lengths per five cycles]."""
    fitted_cycles: Annotated[FittedErrors | None, OMITTED] = None
    """Largest errors of the identified robot in the cycles that were fitted."""


@record
class ExplainedRanges(Record):
    """Share of the markers' vertical ranges that each parameter explains, for each parameter and marker."""

    vertical_range_m_per_prior_deviation: dict[str, dict[str, float]]
    """Change of a range per standard deviation of the parameter's prior [m]."""
    vertical_range_m_from_nominal: dict[str, dict[str, float]]
    """Part of the change from the nominal to the identified robot that each parameter explains; all: the
    whole change [m]."""


@record
class NextFilm(Record):
    """Expected information of a film of one gait."""

    phase: tuple[float, ...]
    """Start of heating of each motor in that gait, as a part of the period."""
    information_bit: float
    """Expected information of the film [bit]."""
    spread_left_of_prior: dict[str, float]
    """For each parameter, its standard deviation after that film, as a part of its prior's."""


@record
class Identification(Record):
    """Results for the reader; no program needs them."""

    model: IdentifiedModel
    """Model check: the residuals of the tracks, compared with their noise."""
    quantities: dict[str, IdentifiedQuantity]
    """Each identified quantity, by its name."""
    not_identified: tuple[str, ...]
    """Names of the quantities that the films do not determine."""
    left_m: TrackErrors
    """Root mean square of the residuals."""
    noise_m: TrackErrors
    """Noise that the fit assumed."""
    held_out_cycle: HeldOutNumbers
    """The last cycle of the last film, which was not fitted, beside its predictions."""
    evaluations: Annotated[int, Field(ge=1)]
    """Number of simulations that the fits of all models took."""
    motor_springs: Annotated[dict[str, tuple[float, ...]] | None, OMITTED] = None
    """For each quantity, the value of each motor's spring; only if the parts differ."""
    explained: Annotated[ExplainedRanges | None, OMITTED] = None
    """Share of the markers' vertical ranges that each parameter explains; only with --figures."""
    next_films: Annotated[tuple[NextFilm, ...] | None, OMITTED] = None
    """Expected information of a film of each gait, the most informative first; only with --figures."""


@record
class PartDifferences(Record):
    """Differences between single strips and springs; both empty if all parts of a kind are equal."""

    strips_m: Numbers
    """Length of each strip beyond the drawing [m], in the design's order; 0 for active springs."""
    springs_z: dict[str, tuple[float, ...]]
    """For each parameter, the difference of each motor's spring from the mean, in standard deviations of the
    parameter's prior."""


@record
class PrintedScene(FileRecord):
    """Result of `eldir calibrate dynamics`; gait, shortlist, report and evolve read it. Files of
    eldir-built-scene/1 are read too."""

    FORMAT = "eldir-built-scene/2"
    OLDER = ("eldir-built-scene/1",)
    OPTIONAL = frozenset()

    built: BuiltParameters
    """Strips, masses and friction of the most probable robot."""
    springs: SpringParameters
    """Springs and their supply: the mean over the motors."""
    parts: PartDifferences
    """Differences between single strips and springs. They hold for the filmed body alone."""
    parameters: tuple[str, ...]
    """Names of the uncertain parameters (`eldir.parameters.uncertain.PARAMETERS`), P of them."""
    z: Numbers
    """Normalised value of each parameter: 0 is nominal, 1 one standard deviation of its prior."""
    covariance: Annotated[FloatArray, Array("f8", None, None)]
    """Covariance of z, shape (P, P)."""
    model_fits: bool = True
    """Whether the model explained the films."""
    body: str | None = None
    """Digest of the filmed body (`Design.body`); null if nothing was filmed."""
    ballast_kg: Numbers = field(default_factory=lambda: np.zeros(0))
    """Ballast on each mass of the filmed robot, both planes together [kg]; empty if there is none."""
    filmed_gaits: tuple[FilmedGait, ...] = ()
    """Filmed gaits, and the displacement of the robot with each."""
    results: Identification | None = None
    """Results for the reader; null if nothing was filmed."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Logs, rig, seed, measurements and version."""

    def __post_init__(self) -> None:
        require_known("parameters", self.parameters, PARAMETERS)
        count = len(self.parameters)
        for name, shape in (("z", (count,)), ("covariance", (count, count))):
            require_shape(name, getattr(self, name).shape, shape)
        even = len(set(map(len, self.parts.springs_z.values()))) <= 1
        require_value("springs_z", even, "one number for each motor")
        for name, values, most in (
            ("z", self.z, _MAX_Z),
            ("covariance", self.covariance, _MAX_Z**2),
            ("springs_z", self.robot.motor_z, _MAX_Z),
            ("strips_m", self.robot.strips, _MAX_STRIP_M),
        ):
            require_value(name, (np.abs(values) <= most).all(), f"numbers from -{most:g} to {most:g}")
        _require_plausible(self.robot)
        scale = np.abs(self.covariance).max(initial=0.0)
        even = np.allclose(self.covariance, self.covariance.T, atol=1e-9 * scale)
        even = even and np.linalg.eigvalsh(self.covariance).min(initial=0.0) >= -1e-9 * scale
        require_value("covariance", even, "symmetric, no negative eigenvalue")

    @classmethod
    def of(
        cls,
        robot: RobotParameters,
        parameters: Sequence[str],
        covariance: FloatArray,
        z: FloatArray | None = None,
    ) -> PrintedScene:
        """The scene of the most probable robot, with the covariance (P, P) of its P uncertain parameters and
        their normalised values `z` relative to the nominal robot, shape (P,); by default zeros."""
        zeros = np.zeros(len(parameters))
        parts = (robot.printed, robot.springs, _parts(robot))
        return cls(*parts, tuple(parameters), zeros if z is None else z, covariance)

    @cached_property
    def robot(self) -> RobotParameters:
        """The most probable robot."""
        z = self.parts.springs_z
        table = np.array(list(z.values())) if z else np.zeros((0, 0))
        return RobotParameters(self.built, self.springs, self.parts.strips_m, tuple(z), table)

    @property
    def identification(self) -> Identification:
        """The results. Raises `InputError` where there are none."""
        if self.results is None:
            raise InputError("the scene has no results", remedy="run eldir calibrate dynamics")
        return self.results

    def robot_of(self, design: Design) -> RobotParameters:
        """The most probable robot of a design: with its identified single parts if the films show this body,
        otherwise with equal parts."""
        return self.robot if self.body == design.body else self.robot.uniform

    def on_rig(self, springs: SpringParameters) -> PrintedScene:
        """The scene with the supply and the air of a rig whose nominal springs are these: what the films told
        of its own nominal current holds relative to that of the rig. Filmed gaits count only with the current
        of their films.

        A scene without a parameter that differs from nominal does not tell its nominal springs; it stays as
        it is. Raises `InputError` where the springs themselves are others.
        """
        if not self.z.any():
            return self
        here = RobotParameters(springs=springs).at(self.parameters, self.z).springs
        others = [
            part.name
            for part in fields(SpringParameters)
            if not np.isclose(getattr(here, part.name), getattr(self.springs, part.name), rtol=_SAME, atol=0)
        ]
        if different := [name for name in others if name not in _SUPPLY_AND_AIR]:
            raise InputError(
                "the scene was identified with other springs than those of the rig file",
                code="scene.other-springs",
                expected="the springs of the films; supply and air may differ",
                found=f"another {', '.join(different)}",
                remedy="give the rig file of the films, or identify the robot with the present springs",
            )
        if not others:
            return self
        moved = replace(self.springs, **{name: getattr(here, name) for name in others})
        same = np.isclose(moved.current(0.0), self.springs.current(0.0), rtol=_SAME)
        return replace(self, springs=moved, filmed_gaits=self.filmed_gaits if same else ())

    def filmed_of(self, design: Design) -> list[FilmedGait]:
        """The filmed gaits, if the films show this body with the same ballast; otherwise none. Films show
        robots on a table, so that they tell nothing about a design's walk on a terrain."""
        ballast = self.ballast_kg if len(self.ballast_kg) else 0.0
        same = self.body == design.body and design.printed_terrain is None
        if not same or not np.allclose(ballast, design.ballast):
            return []
        return list(self.filmed_gaits)

    @classmethod
    def upgrade(cls, values: dict[str, Any]) -> dict[str, Any]:
        """The values of an older file, of format 1 too, as this version has them."""
        values = _from_first(values) if values.get("format") in cls.OLDER else super().upgrade(values)
        if isinstance(springs := values.get("springs"), dict):  # of which files had fewer entries once
            values = values | {"springs": SpringParameters().to_json() | springs}
        return values | {"results": values.get("results") or None}


def _parts(robot: RobotParameters) -> PartDifferences:
    springs = zip(robot.motor_names, map(tuple, robot.motor_z.tolist()), strict=True)
    return PartDifferences(robot.strips, dict(springs))


def _from_first(values: dict[str, Any]) -> dict[str, Any]:
    """Format 1 kept the typed values among results and provenance, under other names."""
    results, provenance = _with_present_keys(values["results"]), dict(values["provenance"])
    names, z = values["knobs"], results.pop("turns", None)
    robot = RobotParameters(BuiltParameters.from_json(values["built"]), SpringParameters(**values["springs"]))
    if "parts" in results:
        parts = results.pop("parts")
        robot = robot.with_parts(parts["strips_m"], parts["springs"])
        results["motor_springs"] = parts["springs"]
    gaits, fits = results.pop("driven", []), bool(results.get("model", {}).get("fits", True))
    try:
        validate(Identification, results, "results")
    except InputError:
        results = {}  # of a version before 0.1.0; they are for the reader alone
    return {
        "built": robot.printed.to_json(),
        "springs": values["springs"],
        "parts": _parts(robot).to_json(),
        "parameters": names,
        "z": [z[name] for name in names] if z else [0.0] * len(names),
        "covariance": values["covariance"],
        "model_fits": fits,
        "body": provenance.pop("body", None),
        "ballast_kg": provenance.pop("ballast_kg", []),
        "filmed_gaits": gaits,
        "results": results,
        "provenance": provenance,
    }


def _require_plausible(robot: RobotParameters) -> None:
    """Refuse numbers so far from every printed robot's that its motion could not be computed in any time."""
    known = [asdict(p) for p in (BuiltParameters(), BuiltParameters().with_hubs(), BuiltParameters.clamped())]
    for part, usual in ((robot.printed, known), (robot.springs, [asdict(SpringParameters())])):
        for name, value in asdict(part).items():
            sizes = [abs(u[name]) for u in usual if u[name]]
            if sizes and value:
                low, high = min(sizes) / _MAX_FACTOR, max(sizes) * _MAX_FACTOR
                require_value(name, low <= abs(value) <= high, f"{low:.3g} to {high:.3g}", f"{value:.3g}")


def _with_present_keys(value: Any) -> Any:
    """Results of format 1 with the keys of the present format, at every depth."""
    if isinstance(value, dict):
        return {_FIRST_KEYS.get(key, key): _with_present_keys(inner) for key, inner in value.items()}
    return [_with_present_keys(inner) for inner in value] if isinstance(value, list) else value
