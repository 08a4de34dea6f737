"""Films from MuJoCo are right: without hubs and sockets they show what the engine predicts."""

from __future__ import annotations

import numpy as np
import pytest

from eldir_cad.multibody.model import Multibody, on_level_table, with_equal_feet, with_pins
from eldir_calibration.dynamics._problem import compute_residual
from eldir_calibration.dynamics.recording import predict_markers
from tests.calibration.dynamics.hidden_rigs import PHASE, walker
from tests.calibration.dynamics.mujoco_films import SecondRig, second_rig

pytest.importorskip("mujoco")

SEED = 100
SHORT = 8.0
"""Of the only cycle [s]: the springs get warm."""


def engines_own(model: Multibody) -> Multibody:
    return with_pins(on_level_table(with_equal_feet(model)))


def apart(rig: SecondRig) -> float:
    """How far the engine's prediction with the hidden parameters is off, root mean square [m]."""
    (x,) = predict_markers(rig.body, [rig.film], [rig.truth])[0]
    moving = compute_residual(rig.film, rig.marks - x).shape[rig.film.tracked.times > 2.0]
    return float(np.sqrt((moving**2).mean()))


def test_without_hubs_a_film_is_what_the_engine_predicts() -> None:
    same = apart(second_rig(walker(), SEED, PHASE, cycles=0, simpler=engines_own, period=SHORT))
    whole = apart(second_rig(walker(), SEED, PHASE, cycles=0, period=SHORT))
    print(same, whole)
    assert same < 0.03e-3
    assert whole > 0.1e-3, "the films show no robot outside of the model"
