"""Work that the engine skips because it does not change the result; equal robots, which are simulated once.

`eldir benchmark skips` switches each shortcut off to measure it. Nothing heavy is imported.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from hashlib import blake2b
from typing import Any, NamedTuple

import numpy as np

from eldir.controller import Controller
from eldir.morphology import Morphology
from eldir.physics import Physics
from eldir.scene import Scene

RING = 4
"""Number of states that are kept where neither a gradient nor a record needs them."""


@dataclass(frozen=True)
class Shortcuts:
    """Switches of the engine's shortcuts."""

    no_controller: bool = True
    """No controller for a body without motors."""
    no_sensing: bool = True
    """No sensing in an open loop."""
    no_history: bool = True
    """Without a gradient and without a record, only the latest states are kept."""
    no_contact: bool = True
    """No contact in free flight."""
    grid: bool = True
    """A grid limits the search for the ground, and masses remember their segment."""
    stop: bool = True
    """No steps after a robot has diverged."""


ALL = Shortcuts()


class SkippedWork(NamedTuple):
    work: str
    """What is not computed."""
    reason: str


def explain_skips(
    morphologies: Sequence[Morphology], scene: Scene, backward: bool, record: bool
) -> Iterator[SkippedWork]:
    """The computations that are skipped in this run, and why; last those that depend on the course of the
    run."""
    passive = sum(body.motors == 0 for body in morphologies)
    springs = sum(len(body.springs) for body in morphologies)
    silent = springs - sum(body.motors for body in morphologies)
    if passive:
        yield SkippedWork(
            "controller, gradient and update", f"{passive} of {len(morphologies)} bodies have no motor"
        )
    if silent:
        yield SkippedWork("controller outputs", f"{silent} of {springs} springs are passive")
    if scene.sensing == "none":
        why = "open loop: the controller receives only its pattern generators"
        yield SkippedWork("sensing, and its gradient", why)
    if not backward:
        yield SkippedWork("reverse pass and weight gradients", "no gradient is needed")
        if not record:
            what = f"history: {RING} states instead of {scene.steps + 1}"
            yield SkippedWork(what, "neither gradient nor record is needed")
    if scene.contact == "none":
        yield SkippedWork("contact", "free flight")
    elif scene.contact == "no-slip":
        yield SkippedWork("search for the ground", "level ground: heights are compared")
    else:
        why = f"a grid gives the first candidate among {len(scene.terrain.x0)} segments"
        yield SkippedWork("search for the ground", why)
        what = "search for masses over the same segment, or above all ground"
        yield SkippedWork(what, "they remember their segment")
    yield SkippedWork("steps after a robot has diverged", "its loss is already infinite")


def distinct(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller | tuple[int, ...]],
    physics: Sequence[Physics],
) -> tuple[list[int], list[int]]:
    """Indices of the first robot of each group of equal robots; and for every robot the index of its group.
    A controller may be given by its seed."""
    origins = [_digest(brain) if isinstance(brain, Controller) else brain for brain in controllers]
    repeated = {origin for origin, count in Counter(origins).items() if count > 1}
    first: list[int] = []
    groups: dict[Any, int] = {}
    group_of_robot = []
    for i, (body, origin, own) in enumerate(zip(morphologies, origins, physics, strict=True)):
        robot = (_digest(body), _digest(own), origin) if origin in repeated else origin
        group = groups.setdefault(robot, len(first))
        if group == len(first):
            first.append(i)
        group_of_robot.append(group)
    return first, group_of_robot


def _digest(record: Morphology | Controller | Physics) -> bytes:
    digest = blake2b(digest_size=16)
    for field in fields(record):
        array = np.ascontiguousarray(getattr(record, field.name))
        digest.update(repr(array.shape).encode())
        digest.update(array.data)
    return digest.digest()
