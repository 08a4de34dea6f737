"""How the best robot of a run changed: its body and its walk every ten generations, as a row of pictures.

Pictures, not a film: bodies and distances are compared side by side, also on paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from eldir.core.pictures import GROUND
from eldir.core.records import FloatArray
from eldir.evolution.figures import draw_springs
from eldir.evolution.paper.history import RunHistory
from eldir.learning import learn
from eldir.morphology import Morphology, develop
from eldir.rollout import simulate
from eldir.terrain import Terrain

_EVERY = 10  # generations
_FEW = 20  # generations: a shorter run is divided into three
_ROWS = 10  # at most, and the last
_MAX_SIZE = np.array([8.0, 10.0])  # of the picture [inch]
_INSTANTS = ((0.0, 0.25), (0.5, 0.5), (1.0, 1.0))
"""When the body is drawn, as a fraction of the walk, and how strongly."""


@dataclass(frozen=True)
class BestWalk:
    """The walk of the best robot after a generation."""

    generation: int
    result: str
    """How far it walks, in words."""
    body: Morphology
    positions: FloatArray
    """Positions of the masses during the walk [m], shape (T, M, 2); NaN where it diverged."""


def choose_generations(last: int) -> list[int]:
    """Generations that are drawn, from 0 to `last`: every ten or a multiple of ten, so that there are eleven
    at most, and the last; of a run shorter than twenty, four at most."""
    every = _EVERY * -(-last // (_EVERY * _ROWS)) if last >= _FEW else max(1, -(-last // 3))
    return sorted({*range(0, last + 1, max(1, every)), last})


def trained_walks(history: RunHistory) -> list[BestWalk]:
    """Walks in the paper's scene, with controllers that are trained again: a run keeps only those of its last
    generation. The same robots with the same seeds learn the same, so runs with inherited weights or sampled
    physics have no such walks."""
    config = history.run.config
    generations = choose_generations(len(history.best) - 1)
    robots = [history.best[g] for g in generations]
    bodies = [develop(config.lattice, robot.genotype(0)) for robot in robots]
    seeds = [int(robot.seeds[0]) for robot in robots]
    trained = learn(bodies, config.scene, config.iterations, seeds, training=config.training)
    rollouts = simulate(bodies, trained.controllers, config.scene)
    return [
        BestWalk(generation, f"{-rollout.loss:+.2f} m", body, rollout.positions)
        for generation, body, rollout in zip(generations, bodies, rollouts, strict=True)
    ]


def draw_walks(walks: Sequence[BestWalk], terrain: Terrain | None = None) -> Figure:
    """Picture of walks one below the other at one scale: the body at the beginning, half-way and at the end,
    and the path of the mean of its masses. `terrain`: the ground, by default level at 0."""
    known = [walk.positions[np.isfinite(walk.positions).all(axis=(1, 2))] for walk in walks]
    if terrain is None or terrain.is_flat:  # all begin at one place
        known = [p - [p[0, :, 0].mean(), 0.0] for p in known]
    low = np.min([p.min(axis=(0, 1)) for p in known], axis=0)
    high = np.max([p.max(axis=(0, 1)) for p in known], axis=0)
    margin = 0.05 * (high[0] - low[0])
    ends = low[0] - margin, high[0] + margin
    line = np.array([[x, 0.0] for x in ends]) if terrain is None else terrain.outline(*ends)
    bottom, top = min(low[1], line[:, 1].min()), max(high[1], line[:, 1].max())
    row = 1.2 * (top - bottom)  # the names are in the gaps
    size = np.array([ends[1] - ends[0], len(walks) * row])
    size *= min(_MAX_SIZE / size)
    figure = Figure(figsize=(max(size[0], 4.0), size[1] + 0.6), layout="constrained")
    axes = figure.add_subplot(xlabel="forward [m]")
    for k, (walk, positions) in enumerate(zip(walks, known, strict=True)):
        lift = np.array([0.0, -k * row - bottom])
        axes.plot(*(line + lift).T, color=GROUND, lw=1.0, zorder=0)
        for fraction, strength in _INSTANTS:
            at = positions[round(fraction * (len(positions) - 1))] + lift
            draw_springs(axes, at, walk.body, (0.7, 1.6), strength)
        axes.plot(*(positions.mean(axis=1) + lift).T, color="#404040", lw=0.8)
        axes.text(
            ends[0], top - bottom - k * row + 0.02 * row, f"generation {walk.generation}: {walk.result}",
            va="bottom", fontsize="small",
        )  # fmt: skip
    axes.set(xlim=ends, ylim=(-(len(walks) - 0.95) * row, row), aspect="equal")
    axes.set_yticks([])
    axes.spines[["top", "right", "left"]].set_visible(False)
    return figure
