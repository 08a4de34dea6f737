"""Names and default values of an evolution. It imports nothing heavy: the command can read them too."""

from __future__ import annotations

from typing import Literal

Crossover = Literal["none", "distinct", "joint"]
CROSSOVER: Crossover = "none"
Ground = Literal["flat", "level", "incline", "decline"]
"""Flat, or rugged; `eldir.evolution.search` has the tilt of each rugged one."""
GROUND: Ground = "flat"
Objective = Literal["paper", "printed"]
OBJECTIVE: Objective = "paper"
"""What robots are judged by: learning in the paper's scene, or the walk of the printed robot."""
LATTICE = (13, 22)
"""Rows and columns of the paper's lattice."""
POPULATION = 64
GENERATIONS = 20
"""Generations of offspring after the random progenitors."""
SEED = 0

MOST_POPULATION, MOST_GENERATIONS, MOST_ITERATIONS = 100_000, 1_000_000, 100_000
"""Largest values that a run takes; the paper has 10 000 robots, 1000 generations and 35 updates."""
