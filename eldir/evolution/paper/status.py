"""The status of a run in the paper's scene: fitness, flags of gradients, and the time that is left."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field, NonNegativeInt, PositiveInt

from eldir.core.records import FloatArray, record
from eldir.evolution import tables
from eldir.evolution.paper.population import Robot, flagged_share
from eldir.evolution.paper.robot_tables import FLAGS, flags
from eldir.evolution.search import Search
from eldir.evolution.status import RunStatus

if TYPE_CHECKING:
    from eldir.evolution.paper.run_folder import RunFolder

_RECENT = 5  # generations of whose durations the median is taken
_LEAST = 0.5  # of a generation; files that lie closer together were copied [s]


@record
class Status(RunStatus):
    """The status of one run."""

    FORMAT = "eldir-status/1"

    learned: NonNegativeInt
    """Robots of the present generation that have learned."""
    population: PositiveInt
    """Number of robots in the population."""
    best_m: float | None
    """Best fitness of the population [m]; null before the first generation is complete."""
    mean_m: float | None
    """Mean fitness of the population [m]; null before the first generation is complete."""
    evaluated: NonNegativeInt
    """Robots evaluated so far."""
    discarded: NonNegativeInt
    """Robots that were discarded as unstable."""
    chaotic_updates: Annotated[float, Field(ge=0, le=1)] | None
    """Share of the population's updates whose gradient chaos dominates; null before the first generation is
    complete, or if an older version trained all robots."""
    rounded_updates: Annotated[float, Field(ge=0, le=1)] | None
    """Share of the population's updates whose gradient rounding may change by a per cent or more; null
    likewise."""
    seconds_a_generation: float | None
    """Time of one generation, median of the last ones [s]; null if unknown."""
    seconds_left: float | None
    """Time until all generations are complete, at that pace [s]; null if unknown."""

    def summary(self) -> str:
        """The status in one line."""
        text = f"{self.state}, {self.whole} of {self.wanted} generations"
        if self.learned:
            text += f" and {self.learned} of {self.population} robots"
        if self.best_m is not None:
            text += f"; best {self.best_m:.3f} m, mean {self.mean_m:.3f} m"
            text += f"; {self.discarded} of {self.evaluated} robots discarded as unstable"
        if flagged := describe_flags(self.chaotic_updates, self.rounded_updates):
            text += f"; {flagged}"
        if self.seconds_a_generation is not None and self.seconds_left is not None:
            text += f"; {_duration(self.seconds_a_generation)} a generation"
            text += f", {_duration(self.seconds_left)} left"
        return text


def describe_flags(chaotic: float | None, rounded: float | None) -> str:
    """The shares of a population's updates whose gradients have flags, in one phrase; empty without flags."""
    shares = {"dominated by chaos": chaotic or 0.0, "possibly by rounding": rounded or 0.0}
    phrases = [f"{100 * share:.1f} % {how}" for how, share in shares.items() if share > 0]
    return f"gradients of updates: {', '.join(phrases)}" if phrases else ""


def progress_line(search: Search[Robot]) -> str:
    """A short line for the progress bar: the last complete generation and its population's fitness."""
    fitness = [r.fitness for r in search.archive.ranked()]
    if not fitness:
        return "no generation yet"
    return f"generation {search.generation - 1}, best {fitness[0]:.3f} m, mean {np.mean(fitness):.3f} m"


def describe_run(run: RunFolder, common: dict[str, Any]) -> Status:
    """The status of a run; `common` has the fields of `RunStatus`."""
    config, generations = run.config, common["whole"]
    complete = run.complete_generations()
    fitness = _fitness(complete[-1][1]) if complete else None
    chaotic, rounded = _flags(complete[-1][1], config.iterations) if complete else (None, None)
    learned = sum(_rows(p) for p in run.parts(generations))
    evaluated = discarded = 0
    for g in range(generations):
        sound = tables.read(run.generation_file(g), ["valid"])["valid"].to_numpy()
        evaluated, discarded = evaluated + len(sound), discarded + int((~sound).sum())
    pace = None if common["state"] == "finished" else _pace(run, generations)
    to_come = common["wanted"] - generations - learned / config.population
    return Status(
        **common,
        learned=learned,
        population=config.population,
        best_m=None if fitness is None else float(fitness.max()),
        mean_m=None if fitness is None else float(fitness.mean()),
        evaluated=evaluated,
        discarded=discarded,
        chaotic_updates=chaotic,
        rounded_updates=rounded,
        seconds_a_generation=pace,
        seconds_left=None if pace is None else pace * to_come,
    )


def _fitness(path: Path) -> FloatArray:
    losses = np.stack(tables.rows(tables.read(path, ["losses"]), "losses"))
    return -losses.min(axis=1)


def _flags(path: Path, iterations: int) -> list[float | None]:
    """Shares of the updates whose gradients have flags; None for not known."""
    table = tables.read(path, ["id"], FLAGS)
    shares = (flagged_share(updates, iterations) for updates in flags(table))
    return [None if np.isnan(share) else share for share in shares]


def _rows(path: Path) -> int:
    return int(tables.read(path, ["id"]).num_rows)


def _pace(run: RunFolder, generations: int) -> float | None:
    """Median time between the last complete generations [s]; an interruption hardly changes it. None where
    the files do not tell it."""
    recent = range(max(0, generations - 1 - _RECENT), generations)
    ends = [run.generation_file(g).stat().st_mtime for g in recent]
    if len(ends) < 2:
        return None
    pace = median(b - a for a, b in pairwise(ends))
    return pace if pace >= _LEAST else None


def _duration(seconds: float) -> str:
    """A duration as text, such as 12 s, 3:05 min or 2:10 h."""
    s = round(seconds)
    if s < 60:
        return f"{s} s"
    return f"{s // 60}:{s % 60:02d} min" if s < 3600 else f"{s // 3600}:{s % 3600 // 60:02d} h"
