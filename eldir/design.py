"""A design: one robot with its taught controller, in one JSON file."""

from __future__ import annotations

import hashlib
import json
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
from eldir.scene import Scene

FORMAT = "eldir-design/1"


@dataclass(frozen=True, eq=False)
class Design(Record):
    """Genotype, controller and the scene it was taught in."""

    lattice: Lattice
    genotype: Genotype
    controller: Controller
    scene: Scene
    provenance: dict[str, Any] = field(default_factory=dict)
    """Where it comes from: run, generation, fitness, versions, seeds. Plain JSON values. A design that
    is built otherwise than evolved keeps here `marks` and, in `variant`, its `ballast`."""

    def __post_init__(self) -> None:
        body = self.morphology
        found = (self.controller.w1.shape[1], self.controller.motors)
        if found != (CPGS + 4 * len(body.positions), body.motors):
            raise InputError(
                "the controller does not fit the body",
                expected=f"{CPGS + 4 * len(body.positions)} inputs and {body.motors} outputs",
                found=f"{found[0]} and {found[1]}",
            )
        marks = self.provenance.get("marks", [])
        if not all(isinstance(m, int) and 0 <= m < len(body.positions) for m in marks):
            raise InputError(
                "provenance.marks names masses that are not there",
                expected=f"numbers from 0 to {len(body.positions) - 1}",
                found=str(marks),
            )

    @cached_property
    def morphology(self) -> Morphology:
        """The developed body."""
        return develop(self.lattice, self.genotype)

    @cached_property
    def marks(self) -> IntArray:
        """Mass indices of m1, m2, ...; those of the design that it was made from, where it is a variant."""
        kept = self.provenance.get("marks")
        return marked_masses(self.morphology) if kept is None else np.array(kept, np.int32)

    @property
    def ballast(self) -> FloatArray:
        """Weight added to each mass, both planes together [kg], shape (M,)."""
        weights = np.zeros(len(self.morphology.positions))
        added = self.provenance.get("variant", {}).get("ballast")
        if added is not None:
            weights[added["mass"]] = 1e-3 * added["grams"]
        return weights

    @property
    def body(self) -> str:
        """Twelve hexadecimal digits: equal for designs that are built alike, but for ballast."""
        values = self.to_json()
        built = json.dumps([values["lattice"], values["genotype"]])
        return hashlib.sha256(built.encode()).hexdigest()[:12]

    def save(self, path: Path | str) -> None:
        """Write the design as JSON; the same design gives the same bytes."""
        write_text(Path(path), json.dumps(self.to_json(), indent=1) + "\n")

    @classmethod
    def load(cls, path: Path | str) -> Design:
        """Read a design; a missing, damaged or foreign file is named."""
        return load_json(path, FORMAT, cls.from_json)

    def to_json(self) -> dict[str, Any]:
        """Plain values; masks as strings of 0 and 1, top row first as a person draws them."""
        rows = self.genotype.triangles[::-1]
        return {
            "format": FORMAT,
            "lattice": {"rows": self.lattice.rows, "columns": self.lattice.columns},
            "genotype": {
                "triangles": ["".join("01"[int(b)] for b in row) for row in rows],
                "springs": "".join("01"[int(b)] for b in self.genotype.springs),
            },
            "controller": {k: getattr(self.controller, k).tolist() for k in ("w1", "b1", "w2", "b2")},
            "scene": self.scene.to_json(),
            "provenance": self.provenance,
        }

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Design:
        """From `to_json`."""
        genes = values["genotype"]
        w = values["controller"]
        return cls(
            Lattice(**values["lattice"]),
            Genotype(np.array([_bits(r) for r in genes["triangles"]][::-1]), _bits(genes["springs"])),
            Controller(w["w1"], w["b1"], np.array(w["w2"], float).reshape(-1, HIDDEN), w["b2"]),
            Scene.from_json(values["scene"]),
            values["provenance"],
        )


def _bits(text: str) -> np.ndarray:
    if set(text) - {"0", "1"}:
        raise InputError("a mask has other characters than 0 and 1", found=repr(text))
    return np.array([c == "1" for c in text])
