"""The built robot as films have shown it: parameters, and how sure they are. JSON "eldir-built-scene/1"."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from eldir.built.filmed_gait import SeenGait
from eldir.built.parts import Parts
from eldir.core.files import load_json, write_text
from eldir.core.records import FloatArray, Record
from eldir.design import Design
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.uncertain import KNOBS, Specimen, specimen

FORMAT = "eldir-built-scene/1"
GEOMETRY = 0.3e-3
"""Standard deviation of a printed strip's length that draws have beside what is identified [m]."""


@dataclass(frozen=True, eq=False)
class BuiltScene(Record):
    """What `eldir calibrate dynamics` writes, and gait, shortlist and report take."""

    built: BuiltParameters
    springs: SpringParameters
    knobs: tuple[str, ...]
    """Of `eldir.parameters.uncertain.KNOBS`, those in doubt."""
    covariance: FloatArray
    """Of their turns, in standard deviations of the priors, shape (knobs, knobs)."""
    results: dict[str, Any] = field(default_factory=dict)
    """For the reader: every quantity with its interval, and the held-out cycle. Plain JSON values."""
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "knobs", tuple(self.knobs))
        unknown = [name for name in self.knobs if name not in KNOBS]
        if unknown:
            raise InputError("unknown knobs", expected=", ".join(KNOBS), found=", ".join(unknown))
        self._set_array("covariance", np.float64, (len(self.knobs), len(self.knobs)))
        scale = np.abs(self.covariance).max(initial=0.0)
        even = np.allclose(self.covariance, self.covariance.T, atol=1e-9 * scale)
        if not even or np.linalg.eigvalsh(self.covariance).min(initial=0.0) < -1e-9 * scale:
            raise InputError("the covariance is none", expected="symmetric, no negative eigenvalue")

    @property
    def specimen(self) -> Specimen:
        """The most probable robot."""
        return self.built, self.springs

    @property
    def turns(self) -> FloatArray:
        """By how much the nominal robot's knobs are turned to be this one, shape (knobs,)."""
        return np.array([self.results["turns"][name] for name in self.knobs], np.float64)

    @property
    def fits(self) -> bool:
        """Whether the model explained the films it comes from; true of scenes that do not say."""
        return bool(self.results.get("model", {}).get("fits", True))

    def parts_of(self, design: Design) -> Parts | None:
        """What was found of each part, where the films are of this body; another one has other parts."""
        parts = self.results.get("parts")
        if parts is None or self.provenance.get("body") != design.body:
            return None
        return Parts.found(self.specimen, parts["strips_m"], parts["springs"])

    def seen_of(self, design: Design) -> list[SeenGait]:
        """The gaits that were filmed, where the films are of this robot, with the same ballast."""
        if self.provenance.get("body") != design.body:
            return []
        if not np.allclose(self.provenance.get("ballast_kg", 0.0), design.ballast):
            return []
        return [SeenGait.from_json(values) for values in self.results.get("driven", ())]

    def draw(self, rng: np.random.Generator, away: float = 1.0) -> Specimen:
        """A robot that may as well be the real one: what is not identified, from its prior.

        `away`: which part of the way to it from the most probable robot is gone.
        """
        values, vectors = np.linalg.eigh(self.covariance)
        z = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(len(values)))
        built, springs = specimen(self.specimen, self.knobs, away * z)
        return replace(built, geometry=away * GEOMETRY), springs

    def save(self, path: Path | str) -> None:
        """Write as JSON; the same scene gives the same bytes."""
        values = {
            "format": FORMAT,
            "built": self.built.to_json(),
            "springs": asdict(self.springs),
            "knobs": list(self.knobs),
            "covariance": self.covariance.tolist(),
            "results": self.results,
            "provenance": self.provenance,
        }
        write_text(Path(path), json.dumps(values, indent=1, allow_nan=False) + "\n")

    @classmethod
    def load(cls, path: Path | str) -> BuiltScene:
        """Read a scene; a missing, damaged or foreign file is named."""
        return load_json(path, FORMAT, cls._from_json)

    @classmethod
    def _from_json(cls, values: dict[str, Any]) -> BuiltScene:
        return cls(
            BuiltParameters.from_json(values["built"]),
            SpringParameters(**values["springs"]),
            tuple(values["knobs"]),
            values["covariance"],
            dict(values["results"]),
            dict(values["provenance"]),
        )
