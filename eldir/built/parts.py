"""The strips and springs of one filmed robot, each as it was found to be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from eldir.built.robot import BuiltRobot, build
from eldir.core.records import FloatArray, Record
from eldir.morphology import Morphology
from eldir.parameters.springs import SpringParameters
from eldir.parameters.uncertain import KNOBS, QUANTITIES, Specimen


@dataclass(frozen=True, eq=False)
class Parts(Record):
    """How parts differ from the robot's knobs, which are their mean."""

    strips: FloatArray
    """How much longer every strip is than drawn [m], shape (S,); 0 for active springs."""
    turns: Mapping[str, FloatArray]
    """Knobs by which springs differ, and how far each motor's is turned from the robot's, shape (A,)."""

    def __post_init__(self) -> None:
        self._set_array("strips", np.float64, (None,))

    @classmethod
    def found(cls, whole: Specimen, strips: FloatArray, values: Mapping[str, FloatArray]) -> Parts:
        """From the value of each quantity for every motor, as results list them."""
        turns = {}
        for name, of_motors in values.items():
            mean, knob = QUANTITIES[name].value(whole), KNOBS[name]
            off = np.subtract(of_motors, mean) if knob.shifts else np.log(np.divide(of_motors, mean))
            turns[name] = off / knob.spread / knob.powers[QUANTITIES[name].parameter]
        return cls(strips, turns)

    def robot(self, body: Morphology, whole: Specimen, ballast: float | FloatArray) -> BuiltRobot:
        """As built, around a robot's knobs; `ballast` as in `build`."""
        robot = build(body, replace(whole[0], geometry=0.0), ballast=ballast)
        return replace(robot, rest_lengths=robot.rest_lengths + self.strips)

    def springs(self, whole: Specimen, motors: int) -> list[SpringParameters]:
        """Of each motor, around a robot's knobs."""
        own = [whole] * motors
        for name, turns in self.turns.items():
            own = [KNOBS[name].turned(one, float(z)) for one, z in zip(own, turns, strict=True)]
        return [springs for _, springs in own]
