"""How a robot's physics may differ from its scene's: what domain randomisation draws while it learns.

From an identified robot, or from what data sheets and geometry leave open of one that was never filmed
(`eldir.parameters.uncertain`). The learning scenes have masses of 1 kg, so stiffness counts against the
printed mass; heat has no counterpart in them, and gravity is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eldir.built.scene import BuiltScene
from eldir.core.records import FloatArray, Record
from eldir.morphology import Morphology
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import STRIP_SPREAD, RobotParameters
from eldir.parameters.uncertain import PARAMETERS, QUANTITIES
from eldir.physics import GRIPPING, Physics
from eldir.scene import Scene

DRAWN = ("friction", "strips", "motors", "damping")
"""A coefficient, and what the stiffness of strips, that of motors and the damping are multiplied by."""


@dataclass(frozen=True, eq=False)
class Doubt(Record):
    """A log-normal distribution of `DRAWN`, and a normal one of every strip's length."""

    centre: FloatArray
    """Of the logarithms, shape (4,)."""
    covariance: FloatArray
    """Of the logarithms, shape (4, 4)."""
    geometry: float
    """Standard deviation of a strip's length, as a part of it."""
    draws: int = 4
    """Robots over which each update of one controller is the mean."""

    def __post_init__(self) -> None:
        self._set_array("centre", np.float64, (len(DRAWN),))
        self._set_array("covariance", np.float64, (len(DRAWN), len(DRAWN)))

    @classmethod
    def of(cls, scene: BuiltScene) -> Doubt:
        """As the identified robot stands to the nominal one, and as much as it is uncertain."""
        mass = QUANTITIES["printed_mass"]
        combined = (
            ({"friction": 1.0}, False),
            ({"tension": 1.0}, True),
            ({"cold_stiffness": 0.5, "hot_stiffness": 0.5}, True),
            ({"drag": 1.0}, False),
        )
        nominal = RobotParameters(springs=scene.robot.springs)
        centre, slopes = np.zeros(len(DRAWN)), np.zeros((len(DRAWN), len(scene.parameters)))
        for i, (shares, per_mass) in enumerate(combined):
            for name, share in shares.items():
                quantity = QUANTITIES[name]
                centre[i] += share * np.log(quantity.value(scene.robot) / quantity.value(nominal))
                slopes[i] += share * quantity.slopes(scene.parameters)
            if per_mass:
                centre[i] -= np.log(mass.value(scene.robot) / mass.value(nominal))
                slopes[i] -= mass.slopes(scene.parameters)
        centre[0] += np.log(BuiltParameters().friction)
        return cls(centre, slopes @ scene.covariance @ slopes.T, STRIP_SPREAD / BuiltParameters().pitch)

    @classmethod
    def unfilmed(cls) -> Doubt:
        """Of a robot that nobody has filmed."""
        return cls.of(BuiltScene(RobotParameters(), tuple(PARAMETERS), np.eye(len(PARAMETERS))))

    def draw(self, body: Morphology, scene: Scene, rng: np.random.Generator) -> Physics:
        """One robot's physics."""
        values, vectors = np.linalg.eigh(self.covariance)
        turns = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(len(DRAWN)))
        friction, strips, motors, damping = np.exp(self.centre + turns)
        off = np.where(body.active, 0.0, self.geometry * rng.standard_normal(len(body.active)))
        return Physics.of(body, scene).replace(
            stiffness=scene.stiffness * np.where(body.active, motors, strips),
            rest_lengths=body.rest_lengths * (1 + off),
            damping=scene.damping * damping,
            friction=friction if scene.contact in GRIPPING else 1.0,
        )

    def draws_of(self, body: Morphology, scene: Scene, seed: int, update: int) -> Sequence[Physics]:
        """The robots of one update, `draws` of them; they depend on nothing else."""
        return [
            self.draw(body, scene, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(update, i))))
            for i in range(self.draws)
        ]

    def to_json(self) -> dict[str, Any]:
        """Plain values; the inverse of `from_json`."""
        return {
            "centre": dict(zip(DRAWN, self.centre.tolist(), strict=True)),
            "covariance": self.covariance.tolist(),
            "geometry": self.geometry,
            "draws": self.draws,
        }

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Doubt:
        """From `to_json`."""
        centre = np.array([values["centre"][name] for name in DRAWN])
        return cls(centre, values["covariance"], float(values["geometry"]), int(values["draws"]))
