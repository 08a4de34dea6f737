"""A design: one robot with its taught controller, in one JSON file."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from eldir.controller import CPGS, HIDDEN, Controller
from eldir.core.files import load_json, write_text
from eldir.core.records import FloatArray, IntArray, Record
from eldir.errors import InputError
from eldir.genotype import Genotype
from eldir.lattice import Lattice
from eldir.marks import marked_masses
from eldir.morphology import Morphology, develop
from eldir.scene import TRAINING_FIELDS, Scene

FORMAT = "eldir-design/1"
_BALLAST = re.compile(r"(?P<grams>\d+(\.\d+)?)\s*g@(?P<place>front|rear|\d+)")
_MOST_GRAMS = 100.0


@dataclass(frozen=True)
class Ballast:
    """A weight on one mass of the body; both planes carry half of it."""

    grams: float
    """Weight on both planes together, holders included [g]."""
    mass: int
    """Index of the mass."""

    @classmethod
    def parse(cls, text: str, morphology: Morphology) -> Ballast:
        """Read a text such as '9g@front', '5g@rear' or '4.5g@12' (a mass by its number)."""
        match = _BALLAST.fullmatch(text.strip())
        if match is None:
            raise InputError(
                "the ballast is not understood",
                expected="GRAMSg@PLACE with place front, rear or a mass's number, such as 9g@front",
                found=repr(text),
            )
        grams, place = float(match["grams"]), match["place"]
        if not 0 < grams <= _MOST_GRAMS:
            raise InputError(
                "the weight of the ballast is out of range",
                expected=f"more than 0 and at most {_MOST_GRAMS:g} g",
                found=f"{grams:g} g",
            )
        if place in ("front", "rear"):
            x, y = np.round(morphology.positions, 9).T
            return cls(grams, int(np.lexsort((y, -x if place == "front" else x))[0]))
        mass, masses = int(place), len(morphology.positions)
        if mass >= masses:
            raise InputError(
                "the ballast is on a mass that does not exist", expected=f"0 to {masses - 1}", found=place
            )
        return cls(grams, mass)


@dataclass(frozen=True)
class Variant:
    """Changes of the built robot from the evolved one. The paper's control robot has one motor fewer and 9 g
    in front."""

    without_motor: int | None = None
    """Number of the motor that a passive spring replaces, from 0, in the evolved design's spring order."""
    ballast: Ballast | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain values; empty for a robot without changes."""
        values: dict[str, Any] = {}
        if self.without_motor is not None:
            values["without_motor"] = self.without_motor
        if self.ballast is not None:
            values["ballast"] = {"grams": self.ballast.grams, "mass": self.ballast.mass}
        return values

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Variant:
        """The inverse of `to_json`."""
        ballast = values.get("ballast")
        added = None if ballast is None else Ballast(float(ballast["grams"]), int(ballast["mass"]))
        return cls(values.get("without_motor"), added)


@dataclass(frozen=True, eq=False)
class Design(Record):
    """A robot's genotype, its controller and the scene in which it was taught."""

    lattice: Lattice
    genotype: Genotype
    controller: Controller
    scene: Scene
    provenance: dict[str, Any] = field(default_factory=dict)
    """Origin of the design: run, generation, fitness, versions, seeds. Plain JSON values for the reader;
    `eldir.built.gait` reads the gait from it."""
    variant: Variant = field(default_factory=Variant)
    """Changes of the built robot from the evolved one."""
    kept_marks: tuple[int, ...] | None = None
    """Mass indices of m1, m2, ... of the evolved design, which a variant keeps. None: `marked_masses` of the
    body."""

    def __post_init__(self) -> None:
        body = self.morphology
        found = (self.controller.w1.shape[1], self.controller.motors)
        if found != (CPGS + 4 * len(body.positions), body.motors):
            raise InputError(
                "the controller does not fit the body",
                expected=f"{CPGS + 4 * len(body.positions)} inputs and {body.motors} outputs",
                found=f"{found[0]} and {found[1]}",
            )
        if self.kept_marks is not None:
            object.__setattr__(self, "kept_marks", tuple(self.kept_marks))
        marks, ballast = list(self.kept_marks or ()), self.variant.ballast
        for name, masses in (
            ("marks", marks),
            ("variant.ballast", [] if ballast is None else [ballast.mass]),
        ):
            if not all(isinstance(m, int) and 0 <= m < len(body.positions) for m in masses):
                raise InputError(
                    f"{name} names masses that are not there",
                    expected=f"numbers from 0 to {len(body.positions) - 1}",
                    found=str(masses),
                )

    @cached_property
    def morphology(self) -> Morphology:
        """The developed body."""
        return develop(self.lattice, self.genotype)

    @cached_property
    def marks(self) -> IntArray:
        """Mass indices of m1, m2, ...; a variant has those of the design that it was made from."""
        if self.kept_marks is None:
            return marked_masses(self.morphology)
        return np.array(self.kept_marks, np.int32)

    @property
    def ballast(self) -> FloatArray:
        """Weight added to each mass, both planes together [kg], shape (M,)."""
        weights = np.zeros(len(self.morphology.positions))
        if self.variant.ballast is not None:
            weights[self.variant.ballast.mass] = 1e-3 * self.variant.ballast.grams
        return weights

    @property
    def body(self) -> str:
        """Digest of the body, twelve hexadecimal digits: the same for all designs with this body, with or
        without ballast."""
        values = self.to_json()
        built = json.dumps([values["lattice"], values["genotype"]])
        return hashlib.sha256(built.encode()).hexdigest()[:12]

    def save(self, path: Path | str) -> None:
        """Write the design as JSON; the same design gives the same bytes."""
        write_text(Path(path), json.dumps(self.to_json(), indent=1) + "\n")

    @classmethod
    def load(cls, path: Path | str) -> Design:
        """Read a design. Raises `InputError` for a missing, damaged or foreign file."""
        return load_json(path, FORMAT, cls.from_json)

    def to_json(self) -> dict[str, Any]:
        """Plain values; masks are strings of 0 and 1, the top row first."""
        rows = self.genotype.triangles[::-1]
        variant = self.variant.to_json()
        return {
            "format": FORMAT,
            "lattice": {"rows": self.lattice.rows, "columns": self.lattice.columns},
            "genotype": {
                "triangles": ["".join("01"[int(b)] for b in row) for row in rows],
                "springs": "".join("01"[int(b)] for b in self.genotype.springs),
            },
            "controller": {k: getattr(self.controller, k).tolist() for k in ("w1", "b1", "w2", "b2")},
            "scene": self.scene.to_json(),
            **({"variant": variant} if variant else {}),
            **({} if self.kept_marks is None else {"marks": list(self.kept_marks)}),
            "provenance": self.provenance,
        }

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Design:
        """The inverse of `to_json`. Older files hold `variant` and `marks` in the provenance, and the
        training in the scene; its record moves to the provenance."""
        genes = values["genotype"]
        w = values["controller"]
        provenance = dict(values["provenance"])
        trained = {name: values["scene"][name] for name in TRAINING_FIELDS if name in values["scene"]}
        if trained:
            provenance.setdefault("training", trained)
        variant = provenance.pop("variant", {}) if "variant" not in values else values["variant"]
        marks = provenance.pop("marks", None) if "marks" not in values else values["marks"]
        lattice = Lattice(**values["lattice"])
        triangles = np.array([_bits(r) for r in genes["triangles"]][::-1])
        if triangles.shape != (lattice.rows, lattice.columns):
            raise InputError(
                "the mask of triangles does not fit the lattice",
                expected=f"{lattice.rows} rows of {lattice.columns}",
                found=" x ".join(map(str, triangles.shape)),
            )
        return cls(
            lattice,
            Genotype(triangles, _bits(genes["springs"])),
            Controller(w["w1"], w["b1"], np.array(w["w2"], float).reshape(-1, HIDDEN), w["b2"]),
            Scene.from_json(values["scene"]),
            provenance,
            Variant.from_json(variant),
            None if marks is None else tuple(marks),
        )


def _bits(text: str) -> np.ndarray:
    if set(text) - {"0", "1"}:
        raise InputError("a mask has other characters than 0 and 1", found=repr(text))
    return np.array([c == "1" for c in text])
