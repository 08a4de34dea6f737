"""Domain randomisation: the distribution from which a robot's physics are sampled while it learns.

It comes from an identified robot, or, for a robot that was never filmed, from the spread that data sheets
and geometry leave (`eldir.parameters.uncertain`). The learning scenes have masses of 1 kg, so a stiffness is
taken relative to the printed mass. Heat has no counterpart in these scenes, and gravity is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, PlainSerializer, WithJsonSchema

from eldir.built.scene import PrintedScene
from eldir.core.arguments import require_value
from eldir.core.records import Array, FloatArray, Record, record
from eldir.morphology import Morphology
from eldir.parameters.printed import STRIP_SPREAD, BuiltParameters
from eldir.parameters.robot import QUANTITIES, RobotParameters
from eldir.parameters.uncertain import PARAMETERS
from eldir.physics import GRIPPING, Physics
from eldir.scene import Scene

_MEANINGS = {
    "friction": "Coefficient of friction.",
    "strips": "Factor on the stiffness of strips.",
    "motors": "Factor on the stiffness of motors.",
    "damping": "Factor on the damping.",
}
RANDOMISED = tuple(_MEANINGS)
"""Names of the sampled values."""


def _values(given: Any) -> Any:
    """The values by name, as a file has them, in the order of `RANDOMISED`."""
    if isinstance(given, dict):
        if set(given) != set(RANDOMISED):
            raise ValueError(f"expected {', '.join(RANDOMISED)}")
        return [given[name] for name in RANDOMISED]
    return given


_ByName = Annotated[
    FloatArray,
    Array("f8", len(RANDOMISED)),
    BeforeValidator(_values),
    PlainSerializer(lambda values: dict(zip(RANDOMISED, values.tolist(), strict=True))),
    WithJsonSchema(
        {
            "type": "object",
            "properties": {n: {"type": "number", "description": m} for n, m in _MEANINGS.items()},
            "required": list(RANDOMISED),
            "additionalProperties": False,
        }
    ),
]


@record
class Randomisation(Record):
    """A log-normal distribution of the values in `RANDOMISED`, and a normal one of every strip's length.

    Raises `InputError` for an invalid shape, numbers that are not finite, or no sample.
    """

    OPTIONAL = frozenset[str]()

    centre: _ByName
    """Means of the logarithms, shape (4,)."""
    covariance: Annotated[FloatArray, Array("f8", len(RANDOMISED), len(RANDOMISED))]
    """Covariance of the logarithms, shape (4, 4)."""
    geometry: Annotated[float, Field(ge=0)]
    """Relative standard deviation of a strip's length."""
    samples: Annotated[int, Field(ge=1, alias="draws")] = 4
    """Number of sampled robots over whose gradients each update takes the mean."""

    def __post_init__(self) -> None:
        even = np.allclose(self.covariance, self.covariance.T)
        require_value("Randomisation.covariance", even, "a symmetric matrix")

    @classmethod
    def of(cls, scene: PrintedScene) -> Randomisation:
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
        centre, slopes = np.zeros(len(RANDOMISED)), np.zeros((len(RANDOMISED), len(scene.parameters)))
        for i, (shares, inverse_masses) in enumerate(combined):
            for name, share in shares.items():
                quantity = QUANTITIES[name]
                centre[i] += share * np.log(quantity.value(scene.robot) / quantity.value(nominal))
                slopes[i] += share * quantity.gradient(scene.parameters)
            if inverse_masses:
                centre[i] -= np.log(mass.value(scene.robot) / mass.value(nominal))
                slopes[i] -= mass.gradient(scene.parameters)
        centre[0] += np.log(BuiltParameters().friction)
        return cls(centre, slopes @ scene.covariance @ slopes.T, STRIP_SPREAD / BuiltParameters().pitch)

    @classmethod
    def unfilmed(cls) -> Randomisation:
        """The distribution for a robot without films: the priors."""
        return cls.of(PrintedScene.of(RobotParameters(), tuple(PARAMETERS), np.eye(len(PARAMETERS))))

    def sample(self, body: Morphology, scene: Scene, rng: np.random.Generator) -> Physics:
        """Sample the physics of one robot."""
        values, vectors = np.linalg.eigh(self.covariance)
        deviations = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(len(RANDOMISED)))
        friction, strips, motors, damping = np.exp(self.centre + deviations)
        off = np.where(body.active, 0.0, self.geometry * rng.standard_normal(len(body.active)))
        return Physics.of(body, scene).replace(
            stiffness=scene.stiffness * np.where(body.active, motors, strips),
            rest_lengths=body.rest_lengths * (1 + off),
            damping=scene.damping * damping,
            friction=friction if scene.contact in GRIPPING else 1.0,
        )

    def sample_update(
        self, body: Morphology, scene: Scene, seed: int | Sequence[int], update: int
    ) -> Sequence[Physics]:
        """Sample the physics of one update, as many as `samples`. They depend on the arguments alone."""
        return [
            self.sample(
                body, scene, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(update, i)))
            )
            for i in range(self.samples)
        ]
