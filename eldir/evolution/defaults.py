"""Names and default values of an evolution. It imports nothing heavy: the command can read them too."""

from __future__ import annotations

from typing import Literal

Crossover = Literal["none", "distinct", "joint"]
CROSSOVER: Crossover = "none"
Ground = Literal["flat", "level", "incline", "decline"]
GROUND: Ground = "flat"
LATTICE = (13, 22)
"""Rows and columns of the paper's lattice."""
POPULATION = 64
GENERATIONS = 20
"""Generations of offspring after the random progenitors."""
SEED = 0
