"""What the engine leaves out of a run because it changes nothing; each can be done the long way for
`eldir benchmark skips`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from eldir.morphology import Morphology
from eldir.scene import Scene

RING = 4
"""States that are kept where none is asked for again."""


@dataclass(frozen=True)
class Shortcuts:
    """Which ones are taken."""

    no_controller: bool = True
    """For a body without motors."""
    no_sensing: bool = True
    """Where no controller listens."""
    no_history: bool = True
    """A few states are kept, in turn, where there is neither a gradient nor a record."""
    no_contact: bool = True
    """Where nothing can be hit."""
    grid: bool = True
    """Tells near which segments of the ground a mass is; masses remember theirs."""
    stop: bool = True
    """Nothing more for a robot that has blown up."""


ALL = Shortcuts()


class Skip(NamedTuple):
    what: str
    why: str


def explain_skips(
    morphologies: Sequence[Morphology], scene: Scene, backward: bool, record: bool
) -> list[Skip]:
    """What is left out of this run, and why; what depends on how the run goes is told last."""
    passive = sum(body.motors == 0 for body in morphologies)
    springs = sum(len(body.springs) for body in morphologies)
    silent = springs - sum(body.motors for body in morphologies)
    skips = []
    if passive:
        skips.append(
            Skip("controller, gradient and update", f"{passive} of {len(morphologies)} bodies have no motor")
        )
    if silent:
        skips.append(Skip("controller outputs", f"{silent} of {springs} springs are passive"))
    if scene.sensing == "none":
        skips.append(
            Skip("sensing, and its gradient", "an open loop: the controller hears only its generators")
        )
    if not backward:
        skips.append(Skip("reverse pass and weight gradients", "nobody asks for a gradient"))
        if not record:
            skips.append(
                Skip(f"history: {RING} states instead of {scene.steps + 1}", "neither gradient nor record")
            )
    if scene.contact == "none":
        skips.append(Skip("contact", "free flight"))
    elif scene.contact == "no-slip":
        skips.append(Skip("search for the ground", "it is level: a height is compared"))
    else:
        segments = len(scene.terrain.x0)
        skips.append(Skip("search for the ground", f"a grid says where to look among {segments} segments"))
        skips.append(
            Skip("search for masses over the segment they were over, or above all ground", "they remember it")
        )
    skips.append(Skip("what follows when a robot blows up", "its loss is infinite already"))
    return skips
