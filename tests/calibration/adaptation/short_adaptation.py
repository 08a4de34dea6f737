"""The command `eldir` with adaptations that take seconds instead of minutes: few samples, phases and cycles.

`python -m tests.calibration.adaptation.short_adaptation adapt ...`; how far a robot walks in the end means
nothing then.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from eldir.built import gait_search, samples
from eldir.built.screening import candidate_gaits
from eldir.controller import Controller
from eldir.design import Design
from eldir.scene import Scene
from eldir_calibration.adaptation import runs
from eldir_calibration.adaptation.runs import AdaptationConfig
from eldir_calibration.dynamics.belief import BeliefConfig
from tests.calibration.dynamics.hidden_rigs import LATTICE, walker, walker_genotype

_FEW: dict[str, Any] = {
    "samples": 2,
    "cycles": 2,
    "min_gain": 0.0,
    "belief": BeliefConfig(members=8, max_steps=1),
}
FEW = AdaptationConfig(runs=2, **_FEW)


def make_walker() -> Design:
    """A design with the body of the hidden rigs' robot."""
    body = walker().morphology
    controller = Controller.random(len(body.positions), body.motors, np.random.default_rng(1))
    return Design(LATTICE, walker_genotype(), controller, Scene.preset("paper"))


def shorten(assign: Callable[[Any, str, Any], None] = setattr) -> None:
    """Let simulated walks last one cycle, and let a third of the phases be searched. `assign`: a function
    that sets an attribute, such as that of a monkeypatch."""
    assign(samples, "CYCLES", 1)
    assign(gait_search, "candidate_gaits", lambda motors: candidate_gaits(motors, 3))


if __name__ == "__main__":
    from eldir_app.main import main

    shorten()
    runs.AdaptationConfig = partial(AdaptationConfig, **_FEW)  # type: ignore[assignment, misc]
    main()
