"""The built robot as identified from films, with its uncertainty. JSON "eldir-built-scene/2"."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from eldir.built.filmed_gait import FilmedGait
from eldir.core.files import load_json, write_text
from eldir.core.records import FloatArray, Record
from eldir.design import Design
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.uncertain import PARAMETERS

FORMAT = "eldir-built-scene/2"
_FIRST = "eldir-built-scene/1"
_LARGEST_Z = 30.0  # standard deviations of a prior; a fit ends at four
_LONGEST = 0.05  # of a strip beyond the drawing [m]; the pitch is 0.057
_FAR = 100.0  # times the nominal value, or a part of it
_FIRST_KEYS = {"strained": "at_edge", "doubt_left_of_prior": "spread_left_of_prior"}


@dataclass(frozen=True, eq=False)
class BuiltScene(Record):
    """Result of `eldir calibrate dynamics`; gait, shortlist, report and evolve read it."""

    robot: RobotParameters
    """The most probable robot. Differences of single parts hold for the filmed body alone."""
    parameters: tuple[str, ...]
    """Names of the uncertain parameters (`eldir.parameters.uncertain.PARAMETERS`), P of them."""
    covariance: FloatArray
    """Covariance of their normalised values z, shape (P, P)."""
    z: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Normalised values z of this robot relative to the nominal one, shape (P,); by default zeros."""
    model_fits: bool = True
    """Whether the model explained the films."""
    body: str | None = None
    """`Design.body` of the filmed robot; None where nothing was filmed."""
    ballast: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Ballast on each mass, both planes together [kg], shape (M,); empty: none."""
    filmed: tuple[FilmedGait, ...] = ()
    """Filmed gaits."""
    results: dict[str, Any] = field(default_factory=dict)
    """Results for the reader: every quantity with its interval, and the held-out cycle. Plain JSON values."""
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("parameters", "filmed"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        unknown = [name for name in self.parameters if name not in PARAMETERS]
        if unknown:
            raise InputError("unknown parameters", expected=", ".join(PARAMETERS), found=", ".join(unknown))
        count = len(self.parameters)
        if not len(self.z):
            object.__setattr__(self, "z", np.zeros(count))
        self._set_array("z", np.float64, (count,))
        self._set_array("ballast", np.float64, (None,))
        self._set_array("covariance", np.float64, (count, count))
        for name, values, most in (
            ("z", self.z, _LARGEST_Z),
            ("covariance", self.covariance, _LARGEST_Z**2),
            ("springs_z", self.robot.motor_z, _LARGEST_Z),
            ("strips_m", self.robot.strips, _LONGEST),
        ):
            if not (np.abs(values) <= most).all():
                raise InputError(f"{name} is wrong", expected=f"numbers from -{most:g} to {most:g}")
        _require_plausible(self.robot)
        scale = np.abs(self.covariance).max(initial=0.0)
        even = np.allclose(self.covariance, self.covariance.T, atol=1e-9 * scale)
        if not even or np.linalg.eigvalsh(self.covariance).min(initial=0.0) < -1e-9 * scale:
            raise InputError("the covariance is wrong", expected="symmetric, no negative eigenvalue")

    def robot_of(self, design: Design) -> RobotParameters:
        """The most probable robot of a design: with its identified single parts if the films show this body,
        otherwise with equal parts."""
        return self.robot if self.body == design.body else self.robot.uniform

    def filmed_of(self, design: Design) -> list[FilmedGait]:
        """The filmed gaits, if the films show this body with the same ballast; otherwise none."""
        ballast = self.ballast if len(self.ballast) else 0.0
        if self.body != design.body or not np.allclose(ballast, design.ballast):
            return []
        return list(self.filmed)

    def save(self, path: Path | str) -> None:
        """Write as JSON; the same scene gives the same bytes."""
        write_text(Path(path), json.dumps(self.to_json(), indent=1, allow_nan=False) + "\n")

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        robot = self.robot
        springs = dict(zip(robot.motor_names, robot.motor_z.tolist(), strict=True))
        return {
            "format": FORMAT,
            "built": robot.printed.to_json(),
            "springs": robot.springs.to_json(),
            "parts": {"strips_m": robot.strips.tolist(), "springs_z": springs},
            "parameters": list(self.parameters),
            "z": self.z.tolist(),
            "covariance": self.covariance.tolist(),
            "model_fits": self.model_fits,
            "body": self.body,
            "ballast_kg": self.ballast.tolist(),
            "filmed_gaits": [gait.to_json() for gait in self.filmed],
            "results": self.results,
            "provenance": self.provenance,
        }

    @classmethod
    def load(cls, path: Path | str) -> BuiltScene:
        """Read a scene, also one of format "eldir-built-scene/1". Raises `InputError` for a missing, damaged
        or foreign file."""
        return load_json(path, FORMAT, cls._from_json, older={_FIRST: cls._from_first})

    @classmethod
    def _from_json(cls, values: dict[str, Any]) -> BuiltScene:
        parts = values["parts"]
        names = tuple(parts["springs_z"])
        z = [parts["springs_z"][name] for name in names]
        robot = RobotParameters(
            BuiltParameters.from_json(values["built"]),
            SpringParameters(**values["springs"]),
            parts["strips_m"],
            names,
            np.array(z) if z else np.zeros((0, 0)),
        )
        return cls(
            robot,
            tuple(values["parameters"]),
            values["covariance"] or np.zeros((0, 0)),
            values["z"],
            values["model_fits"] is True,
            values["body"],
            values["ballast_kg"],
            tuple(FilmedGait.from_json(gait) for gait in values["filmed_gaits"]),
            dict(values["results"]),
            dict(values["provenance"]),
        )

    @classmethod
    def _from_first(cls, values: dict[str, Any]) -> BuiltScene:
        """Read format 1, which kept the typed values among results and provenance, under other names."""
        results, provenance = _with_present_keys(values["results"]), dict(values["provenance"])
        names, z = tuple(values["knobs"]), results.pop("turns", {})
        robot = RobotParameters(
            BuiltParameters.from_json(values["built"]), SpringParameters(**values["springs"])
        )
        if "parts" in results:
            parts = results.pop("parts")
            robot = robot.with_parts(parts["strips_m"], parts["springs"])
            results["motor_springs"] = parts["springs"]
        return cls(
            robot,
            names,
            values["covariance"],
            np.array([z[name] for name in names]) if z else np.zeros(0),
            bool(results.get("model", {}).get("fits", True)),
            provenance.pop("body", None),
            provenance.pop("ballast_kg", ()),
            tuple(FilmedGait.from_json(gait) for gait in results.pop("driven", ())),
            results,
            provenance,
        )


def _require_plausible(robot: RobotParameters) -> None:
    """Refuse numbers so far from every printed robot's that its motion could not be computed in any time."""
    known = [asdict(p) for p in (BuiltParameters(), BuiltParameters().with_hubs(), BuiltParameters.clamped())]
    for part, usual in ((robot.printed, known), (robot.springs, [asdict(SpringParameters())])):
        for name, value in asdict(part).items():
            sizes = [abs(u[name]) for u in usual if u[name]]
            if sizes and value and not min(sizes) / _FAR <= abs(value) <= max(sizes) * _FAR:
                raise InputError(
                    f"{name} is not plausible",
                    expected=f"{min(sizes) / _FAR:.3g} to {max(sizes) * _FAR:.3g}",
                    found=f"{value:.3g}",
                )


def _with_present_keys(value: Any) -> Any:
    """Results of format 1 with the keys of the present format, at every depth."""
    if isinstance(value, dict):
        return {_FIRST_KEYS.get(key, key): _with_present_keys(inner) for key, inner in value.items()}
    return [_with_present_keys(inner) for inner in value] if isinstance(value, list) else value
