"""Whether learning with drawn physics makes gaits that carry over to rigs whose parameters nobody saw.

The same random designs and the same initial weights are taught with and without; each one's closed loop is
copied as a schedule and played on the same hidden rigs: springs and friction 10 to 50 per cent off, strips
0.3 mm. Beside them gaits that are searched over sampled robots in the built scene, as `eldir gait` does.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
import pytest

from eldir.built.gait import CYCLES, Gait, free_lengths
from eldir.built.robot import build
from eldir.built.samples import NominalRobots, SampledWalks, sample_walks
from eldir.built.screening import candidate_gaits, simulate_soft_walks
from eldir.built.walking import displacements
from eldir.controller import Controller
from eldir.core.records import FloatArray
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.problem import PaperProblem
from eldir.evolution.search import Search
from eldir.lattice import Lattice
from eldir.learning import learn
from eldir.morphology import Morphology
from eldir.parameters.robot import RobotParameters
from eldir.rollout import simulate
from eldir.scene import Scene
from eldir.training.randomisation import Randomisation
from eldir_hardware.virtual.bodies import sample_large_spread
from tests.calibration.dynamics.hidden_rigs import NOMINAL

pytestmark = pytest.mark.stress

DESIGNS = int(os.environ.get("DESIGNS", "24"))
DRAWN = 12  # for each design that is kept
RIGS, ITERATIONS, BUILDS = 16, 35, 6
PAPER = Scene.preset("paper")


def imitated(bodies: Sequence[Morphology], controllers: Sequence[Controller]) -> list[Gait]:
    """As `eldir gait --imitate`."""
    return [Gait.from_rollout(r, PAPER) for r in simulate(bodies, controllers, PAPER)]


def searched(body: Morphology) -> Gait:
    """Of all relative phases, the one with which sampled nominal robots walk farthest on average."""
    gaits = candidate_gaits(body.motors)
    tried = sample_walks(NominalRobots(body, RobotParameters()), gaits, BUILDS, 1)
    return gaits[int(np.argmax([walks.expected for walks in tried]))]


def played(body: Morphology, gait: Gait, rigs: Sequence[RobotParameters]) -> SampledWalks:
    """On every rig; each has strips of its own."""
    robots = [build(body, r.printed, rng=np.random.default_rng([i, 8])) for i, r in enumerate(rigs)]
    tables = [free_lengths(gait, rig.springs) for rig in rigs]
    return SampledWalks(displacements(robots, tables, CYCLES, [rig.free_lengths for rig in rigs]))


def between(values: FloatArray) -> str:
    """Mean and the 95 % interval that the bootstrap over designs gives it."""
    rng = np.random.default_rng(0)
    means = rng.choice(values, (4000, len(values))).mean(axis=1)
    return f"{values.mean():+.3f} ({np.quantile(means, 0.025):+.3f} to {np.quantile(means, 0.975):+.3f})"


def test_transfer_to_rigs_that_nobody_saw() -> None:
    config = EvolutionConfig(
        Lattice(6, 11), DRAWN * DESIGNS, max_active=2, static_margin=0.02, buildable=True, seed=11
    )
    asked = Search(PaperProblem(config)).ask()
    every = asked.bodies
    # Most random designs walk in no phase whatsoever; those that do, with soft strips, can tell.
    chosen = np.argsort(-simulate_soft_walks(every))[:DESIGNS].tolist()
    bodies, seeds = [every[i] for i in chosen], [asked.seeds[i] for i in chosen]
    rigs = [sample_large_spread(NOMINAL, 100 + i) for i in range(RIGS)]
    slipping, drawn = PAPER.replace(contact="friction"), Randomisation.unfilmed()
    gaits = {
        "learned as in the paper": imitated(bodies, learn(bodies, PAPER, ITERATIONS, seeds).controllers),
        "learned with drawn physics": imitated(
            bodies, learn(bodies, PAPER, ITERATIONS, seeds, randomisation=drawn).controllers
        ),
        "the same, and drawn friction": imitated(
            bodies, learn(bodies, slipping, ITERATIONS, seeds, randomisation=drawn).controllers
        ),
        "searched over sampled robots": [searched(body) for body in bodies],
    }
    walks = {
        name: [played(body, gait, rigs) for body, gait in zip(bodies, own, strict=True)]
        for name, own in gaits.items()
    }
    first = next(iter(walks))
    for name, found in walks.items():
        # A rig on which it fell counts as none.
        walk = np.array([np.where(np.isfinite(e.displacement), e.displacement, 0.0).mean() for e in found])
        forward = np.array([e.probability_forward for e in found])
        spread = np.array([e.spread for e in found])
        told = f"walk {between(walk)}, spread {between(spread)}, forward {between(forward)}"
        print(f"{name}: {told}, fell {np.mean([e.fallen for e in found]):.2f}")
        if name == first:
            plain, ahead = walk, forward
        else:
            print(f"    against the first: walk {between(walk - plain)}, forward {between(forward - ahead)}")
    chances = {name: np.mean([e.probability_forward for e in found]) for name, found in walks.items()}
    assert chances["searched over sampled robots"] == max(chances.values())
