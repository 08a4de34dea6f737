"""Adaptations that take seconds instead of minutes: few samples, phases and cycles. How far a robot walks in
the end means nothing then."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from eldir.built import gait_search, samples
from eldir.built.screening import candidate_gaits
from eldir_calibration.adaptation.runs import AdaptationConfig
from eldir_calibration.dynamics.belief import BeliefConfig

FEW = AdaptationConfig(runs=2, samples=2, cycles=2, min_gain=0.0, belief=BeliefConfig(members=8, max_steps=1))


def shorten(assign: Callable[[Any, str, Any], None] = setattr) -> None:
    """Let simulated walks last one cycle, and let a third of the phases be searched. `assign`: a function
    that sets an attribute, such as that of a monkeypatch."""
    assign(samples, "CYCLES", 1)
    assign(gait_search, "candidate_gaits", lambda motors: candidate_gaits(motors, 3))
