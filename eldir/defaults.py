"""Names and default values of learning and evolution. Nothing heavy is imported: the command reads this."""

from __future__ import annotations

from typing import Literal

Optimiser = Literal["steps", "adam"]
OPTIMISER: Optimiser = "steps"
UPDATE_LENGTHS: dict[Optimiser, float] = {"steps": 0.2, "adam": 2.0}
"""Usual lengths of an update: the paper's, and the best that was measured (docs/reference/evolution.md)."""
ITERATIONS = 35
"""Updates of every robot."""

EncodingName = Literal["direct", "cppn"]
ENCODING: EncodingName = "direct"
"""What of a body is inherited: every triangle and spring, or a network that paints them."""
Crossover = Literal["none", "distinct", "joint", "neat"]
CROSSOVER: Crossover = "none"
CROSSOVERS: dict[EncodingName, tuple[Crossover, ...]] = {
    "direct": ("none", "distinct", "joint"),
    "cppn": ("none", "neat"),
}
"""Which crossovers an encoding has."""
Ground = Literal["flat", "level", "incline", "decline"]
"""Flat, or rugged; `eldir.evolution.paper.configuration` has the tilt of each rugged one."""
GROUND: Ground = "flat"
Objective = Literal["paper", "printed"]
OBJECTIVE: Objective = "paper"
"""What robots are evaluated by: learning in the paper's scene, or the walk of the printed robot."""
LATTICE = (13, 22)
"""Rows and columns of the paper's lattice."""
POPULATION = 64
GENERATIONS = 20
"""Generations of offspring after the random progenitors."""
SEED = 0
MAX_POPULATION, MAX_GENERATIONS, MAX_ITERATIONS = 100_000, 1_000_000, 100_000
"""Largest values that a run takes; the paper has 10 000 robots, 1000 generations and 35 updates."""

PRINTED_LATTICE = (6, 11)
"""Rows and columns that a printer's workspace holds."""
PRINTED_OFFSPRING, MIN_PRINTED_OFFSPRING = 32, 4
"""Robots of a generation of printed robots; the fewest of which the trials can choose."""
PRINTED_GENERATIONS = 12
PRINTED_MOTORS = 2
"""Four channels heat two motors, each with a spring on both faces."""
PRINTED_MARGIN = 0.02
"""Required static margin of a printed robot [m]."""
PRINTED_TIMINGS = ((30.0, 6.0), (36.0, 6.0))
"""Periods and times of heating [s] that the rig of the template allows (tests hold them against it)."""
