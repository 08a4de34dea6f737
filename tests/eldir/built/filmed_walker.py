"""The walker with hidden parameters, filmed and identified once for all tests that look at what was found."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

from eldir.built.scene import PrintedScene
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG
from eldir_calibration.dynamics.recording import Recording
from eldir_calibration.dynamics.results import identify_robot
from tests.calibration.dynamics.hidden_rigs import SOFT, film, walker
from tests.made_once import made_once

OFF = {"hot_length": 0.8, "cold_length": -0.9, "current": 0.6, "cooling": -0.7, "friction": 0.8,
       "hot_stiffness": -0.9, "buckling": 1.0, "weight": 0.5, "heat": 0.5}  # fmt: skip
"""The hidden robot of these tests: z of its parameters, which only they and the film know."""
TRUTH = SOFT.at(tuple(OFF), list(OFF.values()))

_FEWER = replace(DEFAULT_CONFIG, starts=8, refinement_stages=((2, 5),))


@cache
def filmed() -> Recording:
    return film(walker(), TRUTH, 1, 2)


def identified() -> PrintedScene:
    given = {"logs": ["log.mcap"]}
    return identify_robot(walker(), [filmed()], SOFT, names=tuple(OFF), provenance=given, config=_FEWER)


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Filmed once, for all folders and processes of a run."""
    return made_once(tmp_path_factory, "walker_film", filmed)


@pytest.fixture(scope="session")
def scene(tmp_path_factory: pytest.TempPathFactory) -> PrintedScene:
    """Identified once, for all folders and processes of a run."""
    return made_once(tmp_path_factory, "walker", identified)
