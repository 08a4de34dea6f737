"""Long proofs of the second physics: the built scene's walk as contact stiffens, and the time it takes."""

from dataclasses import replace
from time import process_time

import numpy as np
import pytest

from eldir.built.gait import Gait, free_lengths
from eldir.built.robot import build
from eldir.built.walking import displacements
from eldir_cad.multibody.model import Numerics
from tests.calibration.dynamics.hidden_rigs import PHASE, walker
from tests.hardware.virtual.multibody_models import FREE, pinned, robot, walk

pytestmark = pytest.mark.stress

BODY = walker().morphology
GAIT = Gait(20.0, np.array([0.0, PHASE]), np.array([0.3, 0.3]))


def test_with_pins_it_walks_as_in_the_built_scene() -> None:
    table = free_lengths(GAIT, cycles=1)
    there = displacements([build(BODY)], [table], 1, FREE)[0]
    errors = []
    for step in (1e-3, 0.25e-3, 0.1e-3):
        numerics = Numerics(step=min(step, 0.25e-3), contact_time=2 * step)
        errors.append(abs(walk(pinned(BODY, numerics=numerics), table, 1)[0] - there))
    print(there, errors)
    assert max(errors) < 0.01


def test_a_schedule_takes_at_most_thirty_seconds_of_one_core() -> None:
    table, begun = free_lengths(GAIT), process_time()
    found, counted = walk(robot(BODY), table, 5)
    spent = process_time() - begun
    print(found, spent)
    assert np.isfinite(counted).all() and spent < 30


def test_friction_of_single_feet_changes_the_walk() -> None:
    table, plain = free_lengths(GAIT, cycles=1), robot(BODY)
    walks = []
    for seed in range(4):
        feet = np.exp(0.1 * np.random.default_rng(seed).standard_normal(len(plain.hubs))).tolist()
        hubs = [replace(h, friction=h.friction * f) for h, f in zip(plain.hubs, feet, strict=True)]
        walks.append(walk(replace(plain, hubs=hubs), table, 1)[0])
    print(walks)
    assert np.std(walks) > 1e-3
