"""A design: one robot with its trained controller, in one JSON file; and its marked masses m1 to m5.

The motion of m1 to m5 is compared between simulation and camera (paper, Fig. Sim2real). They lie on the rear
boundary of the body, where the prototype's motors were.
"""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import field
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from eldir.controller import Controller
from eldir.core.arguments import require_shape, require_value
from eldir.core.records import OMITTED, FileRecord, FloatArray, IntArray, Record, record
from eldir.genotype import Genotype
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop
from eldir.scene import TRAINING_FIELDS, Scene
from eldir.terrain import Terrain

MARKS = 5
_ROUNDING = 9  # decimals [m] below which two distances or heights are the same
_BALLAST = re.compile(r"(?P<grams>\d+(\.\d+)?)\s*g@(?P<place>front|rear|\d+)")
_MAX_GRAMS = 100.0


def marked_masses(morphology: Morphology) -> IntArray:
    """Mass indices of m1, m2, ... from the ground up, shape (at most five,).

    The five masses of the rear boundary path that are nearest to the active springs; of equally
    near ones, and in a body without motors, the lower. A shorter path gives fewer.
    """
    path = rear_path(morphology)
    distance = _distance_to_motors(morphology, morphology.positions[path])
    nearest = np.argsort(np.round(distance, _ROUNDING), kind="stable")[:MARKS]
    return path[np.sort(nearest)]


def rear_path(morphology: Morphology) -> IntArray:
    """Masses met on the outer face from the rearmost of the lowest row, along the rear (-x), to
    the rearmost of the top row; each once, where it is first met."""
    x, y = np.round(morphology.positions, _ROUNDING).T
    start = int(np.lexsort((x, y))[0])
    end = int(np.lexsort((x, -y))[0])
    around = _neighbours_by_angle(morphology)
    path, here, back = [start], start, -np.pi / 2  # as if come from below, where nothing is
    while here != end:
        here, back = _next_mass(around, morphology.positions, here, back)
        path.append(here)
    return np.array(list(dict.fromkeys(path)), dtype=np.int32)


def _next_mass(
    around: list[list[tuple[float, int]]], positions: FloatArray, here: int, back: float
) -> tuple[int, float]:
    """The next mass, keeping the outside on the left: the first edge clockwise of the way back."""
    full = 2 * np.pi

    def clockwise(edge: tuple[float, int]) -> float:
        turn = (back - edge[0]) % full
        return full if min(turn, full - turn) < 1e-6 else turn  # turning round comes last

    _, to = min(around[here], key=clockwise)
    return to, _angle(positions[here] - positions[to])


def _neighbours_by_angle(morphology: Morphology) -> list[list[tuple[float, int]]]:
    around: list[list[tuple[float, int]]] = [[] for _ in morphology.positions]
    for a, b in morphology.springs.tolist():
        along = morphology.positions[b] - morphology.positions[a]
        around[a].append((_angle(along), b))
        around[b].append((_angle(-along), a))
    return around


def _angle(along: FloatArray) -> float:
    return float(np.arctan2(along[1], along[0]))


def _distance_to_motors(morphology: Morphology, points: FloatArray) -> FloatArray:
    """From each point to the nearest active spring's segment [m], shape (len(points),)."""
    a, b = (morphology.positions[i] for i in morphology.springs[morphology.active].T)
    if len(a) == 0:
        return np.full(len(points), np.inf)
    along = b - a
    reach = points[:, None] - a
    share = np.clip((reach * along).sum(-1) / (along**2).sum(-1), 0.0, 1.0)
    return np.linalg.norm(reach - share[..., None] * along, axis=-1).min(axis=1)


@record
class Ballast(Record):
    """A weight on one mass of the body; both planes carry half of it."""

    grams: Annotated[float, Field(gt=0)]
    """Weight on both planes together, holders included [g]."""
    mass: Annotated[int, Field(ge=0)]
    """Index of the mass."""

    @classmethod
    def parse(cls, text: str, morphology: Morphology) -> Ballast:
        """Read a text such as '9g@front', '5g@rear' or '4.5g@12' (a mass by its number)."""
        match = _BALLAST.fullmatch(text.strip())
        expected = "GRAMSg@PLACE with place front, rear or a mass's number, such as 9g@front"
        require_value("ballast", match, expected, repr(text))
        assert match is not None
        grams, place = float(match["grams"]), match["place"]
        expected = f"more than 0 and at most {_MAX_GRAMS:g} g"
        require_value("weight of the ballast", 0 < grams <= _MAX_GRAMS, expected, f"{grams:g} g")
        if place in ("front", "rear"):
            x, y = np.round(morphology.positions, 9).T
            return cls(grams, int(np.lexsort((y, -x if place == "front" else x))[0]))
        mass, masses = int(place), len(morphology.positions)
        require_value("mass of the ballast", mass < masses, f"0 to {masses - 1}", place)
        return cls(grams, mass)


@record
class Variant(Record):
    """Changes of the built robot from the evolved one. The paper's control robot has one motor fewer and 9 g
    in front."""

    without_motor: Annotated[Annotated[int, Field(ge=0)] | None, OMITTED] = None
    """Number of the motor that a passive spring replaces, from 0, in the evolved design's spring order."""
    ballast: Annotated[Ballast | None, OMITTED] = None
    """Weight that the built robot carries on one mass."""

    @property
    def changes(self) -> tuple[str, ...]:
        """Each change in words."""
        parts = [] if self.without_motor is None else [f"without motor {self.without_motor}"]
        if self.ballast is not None:
            parts.append(f"with {self.ballast.grams:g} g on mass {self.ballast.mass}")
        return tuple(parts)

    def __str__(self) -> str:
        return ", ".join(self.changes) or "as evolved"


@record
class Design(FileRecord):
    """A robot's genotype, its controller and the scene in which it was trained."""

    FORMAT = "eldir-design/1"
    OPTIONAL = frozenset({"variant", "marks", "printed_terrain", "other_parts"})

    lattice: Lattice
    """Size of the lattice in which the body lies."""
    genotype: Genotype
    """The genes: which triangles and which active springs the robot has."""
    controller: Controller
    """Weights of the neural controller, for M masses and A active springs."""
    scene: Scene
    """The simulation in which the robot was evolved."""
    variant: Annotated[Variant, Field(exclude_if=lambda variant: variant == Variant())] = Variant()
    """Changes of the built robot from the evolved one."""
    kept_marks: Annotated[tuple[Annotated[int, Field(ge=0)], ...] | None, OMITTED, Field(alias="marks")] = (
        None
    )
    """Mass indices of m1, m2, ... of the evolved design, which a variant keeps. None: `marked_masses` of the
    body."""
    printed_terrain: Annotated[Terrain | None, OMITTED] = None
    """The ground under the printed robot [m, of the printed robot]; by default a table."""
    other_parts: Annotated[tuple[str, ...], Field(exclude_if=lambda names: not names)] = ()
    """Parameters in which the printed parts are not the kit's (`eldir packet --parts`); by default none."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Origin of the design: run, generation, fitness, versions, seeds. Plain JSON values for the reader;
    `eldir.built.gait` reads the gait from it."""

    def __post_init__(self) -> None:
        require_shape("triangles", self.genotype.triangles.shape, (self.lattice.rows, self.lattice.columns))
        body = self.morphology
        self.controller.require_fit("the controller", len(body.positions), body.motors)
        marks, ballast = list(self.kept_marks or ()), self.variant.ballast
        for name, masses in (
            ("marks", marks),
            ("variant.ballast", [] if ballast is None else [ballast.mass]),
        ):
            there = all(m < len(body.positions) for m in masses)
            require_value(name, there, f"numbers of masses from 0 to {len(body.positions) - 1}", masses)

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
    def parts_remark(self) -> str:
        """What predictions leave out of this robot's parts; empty for those of the kit."""
        if not self.other_parts:
            return ""
        return (
            f"the parts are not the kit's ({', '.join(self.other_parts)}): predictions are for the kit's "
            "parts, not for this robot"
        )

    @property
    def body(self) -> str:
        """Digest of the body, twelve hexadecimal digits: the same for all designs with this body, with or
        without ballast."""
        built = json.dumps([self.lattice.to_json(), self.genotype.to_json()])
        return hashlib.sha256(built.encode()).hexdigest()[:12]

    @classmethod
    def upgrade(cls, values: dict[str, Any]) -> dict[str, Any]:
        """Older files hold `variant` and `marks` in the provenance, and the training in the scene; its record
        moves to the provenance."""
        provenance, scene = dict(values["provenance"]), values["scene"]
        if trained := {name: scene[name] for name in TRAINING_FIELDS if name in scene}:
            provenance.setdefault("training", trained)
        moved = {
            name: provenance.pop(name)
            for name in ("variant", "marks")
            if name in set(provenance) - set(values)
        }
        return super().upgrade(moved | values | {"provenance": provenance})
