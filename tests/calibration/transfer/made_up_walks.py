"""Made-up walks of a transfer to MuJoCo, and small designs that walk."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eldir.built.gait import Gait
from eldir.built.samples import SampledWalks
from eldir.controller import Controller
from eldir.design import Design
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import develop
from eldir.scene import Scene
from eldir_calibration.transfer.compared_walks import ComparedWalk

GAIT = Gait(4.0, np.array([0.0, 0.125]), np.array([0.3, 0.3]))
"""Fast, so that tests are quick; springs do not cool down in it."""
FALL = -np.inf


def compared(
    predicted: Sequence[float], there: Sequence[float], ties: float = 0.0, file: str = "a.json"
) -> ComparedWalk:
    """A design whose samples and robots in MuJoCo walk as given."""
    walks = SampledWalks(np.array(predicted), np.full(len(predicted), ties))
    seeds = tuple(range(1, 1 + len(there)))
    return ComparedWalk(
        file,
        GAIT,
        True,
        walks,
        seeds,
        SampledWalks(np.array(there)),
        tuple("folds" if w == FALL else "" for w in there),
    )


def tiny_design(provenance: dict[str, object]) -> Design:
    """Six masses with two motors."""
    lattice = Lattice(3, 6)
    genotype = random_genotypes(lattice, 1, np.random.default_rng(10), max_active=2)[0]
    body = develop(lattice, genotype)
    controller = Controller.random(len(body.positions), body.motors, np.random.default_rng(0))
    return Design(lattice, genotype, controller, Scene.preset("paper"), provenance=dict(provenance))


def written_gait(gait: Gait = GAIT) -> dict[str, object]:
    """A gait as `eldir shortlist` writes it into a design."""
    values = {"period_s": gait.period, "phase": gait.phase.tolist(), "duty": gait.duty.tolist()}
    return {"gait": values | {"method": gait.method}}
