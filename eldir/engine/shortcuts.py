"""Work that the engine skips because it does not change the result. `eldir benchmark skips` switches each
shortcut off to measure it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from eldir.morphology import Morphology
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
    """No steps after a robot has blown up."""


ALL = Shortcuts()


class Skip(NamedTuple):
    what: str
    why: str


def explain_skips(
    morphologies: Sequence[Morphology], scene: Scene, backward: bool, record: bool
) -> list[Skip]:
    """The computations that are skipped in this run, and why; last those that depend on the course of the
    run."""
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
            Skip(
                "sensing, and its gradient", "open loop: the controller receives only its pattern generators"
            )
        )
    if not backward:
        skips.append(Skip("reverse pass and weight gradients", "no gradient is needed"))
        if not record:
            skips.append(
                Skip(
                    f"history: {RING} states instead of {scene.steps + 1}",
                    "neither gradient nor record is needed",
                )
            )
    if scene.contact == "none":
        skips.append(Skip("contact", "free flight"))
    elif scene.contact == "no-slip":
        skips.append(Skip("search for the ground", "level ground: heights are compared"))
    else:
        segments = len(scene.terrain.x0)
        skips.append(
            Skip("search for the ground", f"a grid gives the first candidate among {segments} segments")
        )
        skips.append(
            Skip(
                "search for masses over the same segment, or above all ground", "they remember their segment"
            )
        )
    skips.append(Skip("steps after a robot has blown up", "its loss is already infinite"))
    return skips
