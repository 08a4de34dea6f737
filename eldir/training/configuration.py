"""The configuration of training: the optimiser, the length of its updates, and which results count."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from eldir.core.records import Record, record
from eldir.scene import Scene
from eldir.training.defaults import OPTIMISER, UPDATE_LENGTHS, Optimiser
from eldir.training.rules import Adam, FixedLength, Rule

DERIVED: Any = None
"""Default of a field that `__post_init__` derives from other fields."""
_RULES: dict[Optimiser, type[FixedLength] | type[Adam]] = {"steps": FixedLength, "adam": Adam}
_OF_SCENES: dict[str, dict[str, Any]] = {"released-main": {"jump_threshold": 1.0}}


@record
class Training(Record):
    """Configuration of learning: how controllers are taught, and which results are valid.

    The loss and its gradient belong to the scene, and so does `Scene.window`.
    """

    optimiser: Optimiser = OPTIMISER
    """"steps": updates of one length against the gradient, as in the paper. "adam": Kingma and Ba (2015).
    See `eldir.training.rules`."""
    update_length: Annotated[float, Field(gt=0)] = DERIVED
    """Euclidean length of an update; with Adam, of the first one. Default: 0.2 for "steps", 2 for "adam"."""
    jump_threshold: Annotated[float, Field(gt=0)] = 0.5
    """A robot whose loss changes by more than this between two iterations is discarded as unstable [m]."""

    def __post_init__(self) -> None:
        if self.update_length is None:
            object.__setattr__(self, "update_length", UPDATE_LENGTHS[self.optimiser])

    @classmethod
    def of(cls, scene: Scene) -> Training:
        """The defaults of a scene's preset: "released-main" has a `jump_threshold` of 1 m, all others have
        the defaults of this class."""
        return cls(**_OF_SCENES.get(scene.name, {}))

    def rule(self, weights: int) -> Rule:
        """A new update rule for one robot with so many weights."""
        return _RULES[self.optimiser](self.update_length, weights)
