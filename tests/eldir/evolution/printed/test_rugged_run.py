"""Printed robots that evolve on rugged ground: the command, its files, and what refuses them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from eldir.errors import InputError
from eldir.evolution.designs import load_run
from eldir.evolution.printed.configuration import PrintedEvolutionConfig
from eldir.evolution.printed.run_folder import PrintedRun
from eldir.evolution.printed.trials import Trial, evaluate_walks
from eldir.evolution.search import make_terrain
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.terrain import Terrain
from eldir_app.application import application
from tests.eldir.built.grounds import plane
from tests.eldir.evolution.printed.small_searches import BODY, GAIT, SMALL
from tests.raised import raises

pytestmark = pytest.mark.slow(30)

EVOLVE = "evolve --objective printed --lattice 4x7 --population 4 --generations 1 --static-margin 0 --seed 4"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rugged") / "run"
    result = CliRunner().invoke(application(), [*EVOLVE.split(), "--terrain", "level", "--out", str(path)])
    assert result.exit_code == 0, result.output
    return path


def test_the_run_holds_the_paper_s_ground_in_the_robot_s_size(run: Path) -> None:
    terrain = PrintedRun.open(run).config.terrain
    assert terrain == make_terrain("level", 4).scaled(BuiltParameters().scale)
    assert terrain.slope.tolist() == make_terrain("level", 4).slope.tolist()
    assert json.loads((run / "run.json").read_text())["config"]["terrain"]["x0"][1] == 0.0


def test_its_elites_walk_on_that_ground(run: Path) -> None:
    """Each elite's walks are those of its trial on the terrain, and not those on a table."""
    folder = PrintedRun.open(run)
    elites = folder.restore().archive.ranked()
    assert elites
    for ground, same in ((folder.config.terrain, True), (None, False)):
        trials = [
            Trial(
                w.genome.body(folder.config.lattice),
                (w.genome.gait(w.genome.body(folder.config.lattice), folder.config.timings),),
                (folder.config.seed, w.number, 2),
                terrain=ground,
            )
            for w in elites
        ]
        walks = evaluate_walks(trials, folder.config.nominal)
        found = [np.array_equal(own, w.walks[:8]) for own, w in zip(walks, elites, strict=True)]
        assert all(found) if same else not any(found)


def test_the_analysis_draws_the_ground_and_a_shortlist_is_refused(run: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(application(), ["analyse", str(run), "--out", str(tmp_path / "analysis")])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "analysis" / "ground.svg").stat().st_size > 1000
    assert "ground.svg" in (tmp_path / "analysis" / "index.html").read_text()
    with raises(InputError, "evolution.terrain", match="walk on rugged ground"):
        load_run(run)


def test_a_slope_is_walked_as_a_tilted_table() -> None:
    """The same trial, the slope as ground or as tilt; a robot on a slope begins level and settles."""
    slope = float(np.tan(np.radians(1)))
    tilted = RobotParameters(replace(BuiltParameters(), tilt=float(np.radians(1))))
    (there,) = evaluate_walks([Trial(BODY, (GAIT,), (3,), terrain=plane(-slope))], RobotParameters())
    (here,) = evaluate_walks([Trial(BODY, (GAIT,), (3,))], tilted)
    (level,) = evaluate_walks([Trial(BODY, (GAIT,), (3,))], RobotParameters())
    assert (np.abs(here) > 0.01).sum() >= 3
    assert (np.abs(there - here) < 1e-3).sum() >= 7  # a sample may fall in one of them
    assert np.abs(level - here).max() > 0.05


def test_terrains_in_configurations() -> None:
    ground = Terrain.rugged(np.random.default_rng(1))
    config = replace(SMALL, terrain=ground)
    assert PrintedEvolutionConfig.from_json(config.to_json()) == config
    assert "terrain" not in SMALL.to_json()
    with raises(InputError, "printed-evolution.inconsistent", "terrain", match="slopes up to 20"):
        replace(SMALL, terrain=plane(25.0))
