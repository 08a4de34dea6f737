"""Printed robots as designs: with the gait that evolved, and a controller taught for the paper's comparison.

The closed-loop rollout is one of the three motions of a report. A printed robot evolves without a controller,
so the elites are taught when they are read; the same run always gives the same controllers.
"""

from __future__ import annotations

from eldir.core.version import __version__
from eldir.design import Design
from eldir.evolution.printed.run_folder import PrintedRun
from eldir.evolution.search import robot_seed
from eldir.learning import learn
from eldir.scene import Scene

MOST = 24
"""Elites that become designs, the best first: a shortlist holds at most twelve."""


def designs_of(run: PrintedRun) -> list[Design]:
    """The best elites of a run, with gait and expected walk in their provenance."""
    config, scene = run.config, Scene()
    elites = run.restore().archive.ranked()[:MOST]
    if not elites:
        return []
    bodies = [w.genome.body(config.lattice) for w in elites]
    seeds = [robot_seed(config.seed, w.generation, w.number) for w in elites]
    taught = learn(bodies, scene, seed=seeds)
    return [
        Design(
            config.lattice,
            walker.genome.genotype,
            controller,
            scene,
            provenance={
                "fitness_m": -float(losses.min()),
                "generation": walker.generation,
                "id": walker.number,
                "parents": [walker.parent] if walker.parent >= 0 else [],
                "seed": seed,
                "run_seed": config.seed,
                "version": __version__,
                "evolved_walk": {
                    "expected": walker.expected,
                    "standard_error": walker.error,
                    "samples": len(walker.walks),
                },
                "gait": walker.genome.gait(body, config.timings).to_json(),
            },
        )
        for walker, body, controller, losses, seed in zip(
            elites, bodies, taught.controllers, taught.losses, seeds, strict=True
        )
    ]
