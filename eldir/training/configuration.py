"""The configuration of training: the optimiser, the length of its updates, and which results count."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from numbers import Real
from typing import Any, get_args

import numpy as np

from eldir.core.records import Record
from eldir.errors import InputError
from eldir.scene import TRAINING_FIELDS, Scene
from eldir.training.defaults import OPTIMISER, UPDATE_LENGTHS, Optimiser
from eldir.training.rules import Adam, FixedLength, Rule

DERIVED: Any = None
"""Default of a field that `__post_init__` derives from other fields."""
_RULES: dict[Optimiser, type[FixedLength] | type[Adam]] = {"steps": FixedLength, "adam": Adam}
_OF_SCENES: dict[str, dict[str, Any]] = {"released-main": {"jump_threshold": 1.0}}


@dataclass(frozen=True, eq=False)
class Training(Record):
    """Configuration of learning: how controllers are taught, and which results are valid.

    The loss and its gradient belong to the scene, and so does `Scene.window`.
    """

    optimiser: Optimiser = OPTIMISER
    """"steps": updates of one length against the gradient, as in the paper. "adam": Kingma and Ba (2015).
    See `eldir.training.rules`."""
    update_length: float = DERIVED
    """Euclidean length of an update; with Adam, of the first one. Default: 0.2 for "steps", 2 for "adam"."""
    jump_threshold: float = 0.5
    """A robot whose loss changes by more than this between two iterations is discarded as unstable [m]."""

    def __post_init__(self) -> None:
        if self.optimiser not in get_args(Optimiser):
            allowed = " | ".join(get_args(Optimiser))
            raise InputError("Training.optimiser is wrong", expected=allowed, found=repr(self.optimiser))
        if self.update_length is None:
            object.__setattr__(self, "update_length", UPDATE_LENGTHS[self.optimiser])
        for name in ("update_length", "jump_threshold"):
            value = getattr(self, name)
            number = isinstance(value, Real)
            if not (number and 0 < value < np.inf):
                raise InputError(f"Training.{name} is wrong", expected="a positive length", found=repr(value))

    @classmethod
    def of(cls, scene: Scene) -> Training:
        """The defaults of a scene's preset: "released-main" has a `jump_threshold` of 1 m, all others have
        the defaults of this class."""
        return cls(**_OF_SCENES.get(scene.name, {}))

    def rule(self, weights: int) -> Rule:
        """A new update rule for one robot with so many weights."""
        return _RULES[self.optimiser](self.update_length, weights)

    def to_json(self) -> dict[str, Any]:
        """Plain values; the inverse of `from_json`."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Training:
        """The inverse of `to_json`."""
        return cls(**values)

    @classmethod
    def from_scene_json(cls, values: Mapping[str, Any]) -> Training:
        """From the "scene" of an older run or design, which held these fields."""
        return cls(**{name: values[name] for name in TRAINING_FIELDS if name in values})
