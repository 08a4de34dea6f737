"""Names and default values of training. It imports nothing heavy: the command can read them too."""

from __future__ import annotations

from typing import Literal

Optimiser = Literal["steps", "adam"]
OPTIMISER: Optimiser = "steps"
UPDATE_LENGTHS: dict[Optimiser, float] = {"steps": 0.2, "adam": 2.0}
"""Usual lengths of an update: the paper's, and the best that was measured (docs/reference/evolution.md)."""
ITERATIONS = 35
"""Updates of every robot."""
