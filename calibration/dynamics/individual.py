"""One robot in all its parts: no strip is as long as drawn, and no spring is quite like the next.

Beside the knobs of `eldir.parameters.uncertain`, which turn all of a kind, every strip has a turn of its
length, and the springs have turns against each other: contrasts, which leave their mean to the knob. Only
where the knobs alone leave something unexplained are these asked for (`calibration.dynamics.results`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from eldir.built.robot import BuiltRobot, build
from eldir.built.scene import GEOMETRY
from eldir.core.records import FloatArray, Record
from eldir.morphology import Morphology
from eldir.parameters.springs import SpringParameters
from eldir.parameters.uncertain import KNOBS, Specimen, specimen

SPRINGS = {
    "hot_length": 0.02,
    "cold_length": 0.05,
    "current": 0.05,
    "cooling": 0.05,
    "latent_heat": 0.05,
    "transition": 1.0,
}
"""Knobs by which springs of one robot differ, with the standard deviation of the logarithm (of temperatures
[K]): 1.5 mm of length; contacts and leads; places in the fan's stream; the wire's composition."""
_STRIP, _SPRING = "strip", "spring"


@dataclass(frozen=True, eq=False)
class Individual(Record):
    """A specimen, and how its parts differ."""

    specimen: Specimen
    strips: FloatArray
    """How much longer every strip is than drawn [m], shape (S,); 0 for active springs."""
    springs: tuple[SpringParameters, ...]
    """Of each motor."""

    def robot(self, body: Morphology, ballast: FloatArray | float) -> BuiltRobot:
        """As built."""
        robot = build(body, self.specimen[0], ballast=ballast)
        return replace(robot, rest_lengths=robot.rest_lengths + self.strips)


def own_names(body: Morphology) -> tuple[str, ...]:
    """Turns that a robot's parts have beside its knobs: "strip 7", "spring 1 hot_length"."""
    strips = [f"{_STRIP} {s}" for s in np.flatnonzero(~body.active)]
    springs = [f"{_SPRING} {a} {name}" for name in SPRINGS for a in range(1, body.motors)]
    return (*strips, *springs)


def silent(name: str) -> bool:
    """Whether no motion tells a turn."""
    return name in KNOBS and KNOBS[name].silent


def individual(
    body: Morphology, nominal: Specimen, names: Sequence[str], z: Sequence[float] | FloatArray
) -> Individual:
    """The nominal robot with some knobs and parts turned, by standard deviations of their priors."""
    common = [(name, turn) for name, turn in zip(names, z, strict=True) if name in KNOBS]
    whole = specimen(nominal, [name for name, _ in common], [turn for _, turn in common])
    strips = np.zeros(len(body.active))
    apart = {name: np.zeros(body.motors) for name in SPRINGS}
    for name, turn in zip(names, z, strict=True):
        kind, *which = name.split(" ")
        if kind == _STRIP:
            strips[int(which[0])] = GEOMETRY * turn
        elif kind == _SPRING:
            spread = SPRINGS[which[1]] / KNOBS[which[1]].spread
            apart[which[1]] += spread * turn * contrasts(body.motors)[int(which[0]) - 1]
    own = []
    for motor in range(body.motors):
        turned = specimen(whole, list(apart), [turns[motor] for turns in apart.values()])
        own.append(turned[1])
    return Individual(whole, strips, tuple(own))


@cache
def contrasts(motors: int) -> FloatArray:
    """Orthogonal ways in which motors differ, each of sum zero and mean square one (Helmert), shape
    (motors - 1, motors)."""
    rows = np.zeros((motors - 1, motors))
    for i in range(1, motors):
        rows[i - 1, :i], rows[i - 1, i] = 1.0, -i
    return rows / np.sqrt((rows**2).mean(axis=1, keepdims=True))
