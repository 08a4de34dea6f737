"""Domain randomisation: the distribution from which a robot's physics are drawn while it learns.

It comes from an identified robot, or, for a robot that was never filmed, from the spread that data sheets
and geometry leave (`eldir.parameters.uncertain`). The learning scenes have masses of 1 kg, so a stiffness is
taken relative to the printed mass. Heat has no counterpart in these scenes, and gravity is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eldir.built.scene import BuiltScene
from eldir.core.records import FloatArray, Record
from eldir.core.run_limits import whole_number
from eldir.errors import InputError
from eldir.morphology import Morphology
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import STRIP_SPREAD, RobotParameters
from eldir.parameters.uncertain import PARAMETERS, QUANTITIES
from eldir.physics import GRIPPING, Physics
from eldir.scene import Scene

DRAWN = ("friction", "strips", "motors", "damping")
"""Names of the drawn values: a coefficient of friction; factors on the stiffness of strips, on that of
motors, and on the damping."""


@dataclass(frozen=True, eq=False)
class Randomisation(Record):
    """A log-normal distribution of the values in `DRAWN`, and a normal one of every strip's length.

    Raises `InputError` for a wrong shape, numbers that are not finite, or no draw.
    """

    centre: FloatArray
    """Means of the logarithms, shape (4,)."""
    covariance: FloatArray
    """Covariance of the logarithms, shape (4, 4)."""
    geometry: float
    """Relative standard deviation of a strip's length."""
    draws: int = 4
    """Number of drawn robots over whose gradients each update takes the mean."""

    def __post_init__(self) -> None:
        self._set_array("centre", np.float64, (len(DRAWN),))
        self._set_array("covariance", np.float64, (len(DRAWN), len(DRAWN)))
        object.__setattr__(self, "draws", whole_number("Randomisation.draws", self.draws, 1))
        for name in ("centre", "covariance"):
            if not np.isfinite(getattr(self, name)).all():
                raise InputError(f"Randomisation.{name} is wrong", expected="finite numbers")
        if not np.allclose(self.covariance, self.covariance.T):
            raise InputError("Randomisation.covariance is wrong", expected="a symmetric matrix")
        if not 0 <= self.geometry < np.inf:
            raise InputError(
                "Randomisation.geometry is wrong", expected="0 or more", found=repr(self.geometry)
            )

    @classmethod
    def of(cls, scene: BuiltScene) -> Randomisation:
        """The distribution of an identified robot: its values relative to the nominal robot, with the
        uncertainty of the identification."""
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
    def unfilmed(cls) -> Randomisation:
        """The distribution for a robot that nobody has filmed: the priors."""
        return cls.of(BuiltScene.of(RobotParameters(), tuple(PARAMETERS), np.eye(len(PARAMETERS))))

    def draw(self, body: Morphology, scene: Scene, rng: np.random.Generator) -> Physics:
        """Draw the physics of one robot."""
        values, vectors = np.linalg.eigh(self.covariance)
        deviations = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(len(DRAWN)))
        friction, strips, motors, damping = np.exp(self.centre + deviations)
        off = np.where(body.active, 0.0, self.geometry * rng.standard_normal(len(body.active)))
        return Physics.of(body, scene).replace(
            stiffness=scene.stiffness * np.where(body.active, motors, strips),
            rest_lengths=body.rest_lengths * (1 + off),
            damping=scene.damping * damping,
            friction=friction if scene.contact in GRIPPING else 1.0,
        )

    def draws_of(
        self, body: Morphology, scene: Scene, seed: int | Sequence[int], update: int
    ) -> Sequence[Physics]:
        """The physics of one update, `draws` of them. They depend on the arguments alone."""
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
    def from_json(cls, values: dict[str, Any]) -> Randomisation:
        """The inverse of `to_json`."""
        centre = np.array([values["centre"][name] for name in DRAWN])
        return cls(centre, values["covariance"], float(values["geometry"]), int(values["draws"]))
