"""Physical parameters of one robot, if they differ from those of its scene and its body.

Domain randomisation draws them at random; an identification fits them to a real robot. The gradient with
respect to them is a record of the same shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from eldir.core.arguments import require_count, require_known, require_shape, require_value
from eldir.core.records import FloatArray, Record
from eldir.morphology import Morphology
from eldir.scene import Scene

GRIPPING = ("friction", "friction-released")
"""Kinds of contact that have a coefficient of friction."""


@dataclass(frozen=True, eq=False)
class Physics(Record):
    """Parameters of a robot with M masses of 1 kg and S springs."""

    stiffness: FloatArray
    """Stiffness of every spring [N/m], shape (S,)."""
    rest_lengths: FloatArray
    """Rest length of every spring, its motor at rest [m], shape (S,)."""
    velocities: FloatArray
    """Initial velocities of the masses [m/s], shape (M, 2)."""
    damping: float
    """Damping: velocities decay by exp(-damping dt) in each step [1/s]."""
    gravity: float
    """Gravity, positive upwards [m/s2]."""
    friction: float
    """Ratio of the speed lost along the ground to the speed lost across it, where masses can slip; 1 in the
    paper. It has no effect without slip."""

    def __post_init__(self) -> None:
        self._set_array("stiffness", np.float64, (None,))
        self._set_array("rest_lengths", np.float64, (len(self.stiffness),))
        self._set_array("velocities", np.float64, (None, 2))

    @classmethod
    def of(cls, body: Morphology, scene: Scene) -> Physics:
        """The parameters of this scene and this body."""
        return resolve_physics([body], scene, None)[0]

    def scaled(self, factor: float) -> Physics:
        """A copy with every value multiplied by a factor."""
        return Physics(*(factor * getattr(self, name) for name in _NAMES))

    def replace(self, **changes: Any) -> Physics:
        """A copy with some fields changed; one number stands for all springs or masses."""
        for key, value in changes.items():
            require_known("field of physics", key, _NAMES)
            ours = getattr(self, key)
            if isinstance(ours, np.ndarray) and np.ndim(value) == 0:
                changes[key] = np.full_like(ours, value)
        return replace(self, **changes)


_NAMES = tuple(f.name for f in fields(Physics))


def resolve_physics(
    morphologies: Sequence[Morphology], scene: Scene, physics: Sequence[Physics] | None
) -> list[Physics]:
    """One record for every robot: the given ones after a check of their shapes, or those of the scene and the
    bodies."""
    if physics is None:
        most = [max((len(getattr(m, k)) for m in morphologies), default=0) for k in ("springs", "positions")]
        stiffness, still = np.full(most[0], scene.stiffness), np.zeros((most[1], 2))
        scalars = scene.damping, scene.gravity, 1.0
        return [
            Physics.construct(
                stiffness[: len(m.springs)], m.rest_lengths, still[: len(m.positions)], *scalars
            )
            for m in morphologies
        ]
    require_count("physics", len(physics), len(morphologies))
    for i, (own, body) in enumerate(zip(physics, morphologies, strict=True)):
        _check_values(i, own, body, scene)
    return list(physics)


def _check_values(i: int, own: Physics, body: Morphology, scene: Scene) -> None:
    remedy = "start from Physics.of(body, scene)"
    for key, wanted in (("stiffness", (len(body.springs),)), ("velocities", body.positions.shape)):
        require_shape(f"Physics.{key} of robot {i}", getattr(own, key).shape, wanted, remedy=remedy)
    for key, least in (("stiffness", 0), ("rest_lengths", 0), ("damping", 0), ("friction", 0),
                       ("gravity", -np.inf), ("velocities", -np.inf)):  # fmt: skip
        values = np.asarray(getattr(own, key), float)
        good, kind = (
            (np.isfinite(values) & (values >= least)).all(),
            "finite" if least else "finite, at least 0",
        )
        require_value(f"Physics.{key} of robot {i}", good, kind, f"{values.min():g}")
    require_value(
        f"Physics.friction of robot {i}",
        own.friction == 1 or scene.contact in GRIPPING,
        f"1 where the contact is {scene.contact!r}",
        f"{own.friction:g}",
        "Scene.replace(contact='friction')",
    )
