"""Printed robots that evolve on rugged ground: the command, its files, and what refuses them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from eldir.built import samples, screening
from eldir.built.gait import read_gait
from eldir.built.gait_search import HeatingLimits, nominal_robots
from eldir.built.robot import build
from eldir.built.samples import sample_walks, simulate_most_probable
from eldir.built.walking import walk
from eldir.design import Design
from eldir.errors import InputError
from eldir.evolution.designs import load_run
from eldir.evolution.paper.configuration import make_terrain
from eldir.evolution.paper.run_folder import RunFolder
from eldir.evolution.printed.configuration import PrintedEvolutionConfig
from eldir.evolution.printed.run_folder import PrintedRun
from eldir.evolution.printed.trials import Trial, evaluate_walks
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir.terrain import Terrain, TerrainFile
from eldir_app.application import application
from eldir_cad.shortlist.folder import RankingRow, draw_designs
from eldir_cad.shortlist.ranking import RankedDesign, rank
from tests.eldir.built.grounds import plane
from tests.eldir.built.robots_alike import NO_ERRORS
from tests.eldir.evolution.printed.small_searches import BODY, GAIT, SMALL
from tests.raised import raises

pytestmark = pytest.mark.slow(30)

EVOLVE = "evolve --objective printed --lattice 4x7 --population 4 --generations 0 --seed 4"
SMALLEST = "evolve --lattice 4x7 --population 2 --generations 0 --iterations 1"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """On the ground of a file in the paper's size, which is that of `--terrain level` with this seed."""
    path = tmp_path_factory.mktemp("rugged") / "run"
    file = path.parent / "paper.json"
    TerrainFile("paper", make_terrain("level", 4)).save(file)
    result = CliRunner().invoke(application(), [*EVOLVE.split(), "--terrain", str(file), "--out", str(path)])
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
    elites = folder.read_last_elites()
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


def test_the_analysis_draws_the_ground(run: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(application(), ["analyse", str(run), "--out", str(tmp_path / "analysis")])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "analysis" / "ground.svg").stat().st_size > 1000
    assert "ground.svg" in (tmp_path / "analysis" / "index.html").read_text()


def test_its_designs_know_their_ground(run: Path, tmp_path: Path) -> None:
    """In both sizes: the controller is trained on the paper's, the printed robot is built for its own."""
    terrain = PrintedRun.open(run).config.terrain
    design = load_run(run)[0]
    assert terrain is not None and design.printed_terrain == terrain
    assert np.allclose(design.scene.terrain.intercept, make_terrain("level", 4).intercept, atol=1e-12)
    assert design.scene.contact == "friction"
    design.save(tmp_path / "design.json")
    assert Design.load(tmp_path / "design.json") == design
    flat = replace(design, printed_terrain=None)
    assert "printed_terrain" not in flat.to_json()


def test_gaits_are_searched_and_predicted_on_it(run: Path) -> None:
    design = load_run(run)[0]
    rig = HeatingLimits(SpringParameters(), lambda gait: True, lambda springs, motors: (20.0, 0.3), NO_ERRORS)
    gait = read_gait(design)
    assert gait is not None
    here, table = nominal_robots(design, rig), nominal_robots(replace(design, printed_terrain=None), rig)
    (walks,) = sample_walks(here, [gait], 2, coarse=True, cycles=1)
    robots = [build(design.morphology, one).coarse() for one in here.samples(2, 0)]
    own = [walk(r, gait, cycles=1, terrain=design.printed_terrain) for r in robots]
    assert walks.displacement == pytest.approx(own, abs=0.05)  # but for each motor's own springs
    probable = simulate_most_probable(here, [gait], cycles=1, coarse=True)
    robot = build(design.morphology, here.robot).coarse()
    assert probable == walk(robot, gait, cycles=1, terrain=design.printed_terrain)
    assert probable != simulate_most_probable(table, [gait], cycles=1, coarse=True)


def test_a_shortlist_ranks_walks_on_it(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One cycle of the samples counts, not five."""
    monkeypatch.setattr(samples, "CYCLES", 1)
    monkeypatch.setattr(screening, "CYCLES", 1)
    design = load_run(run)[0]
    (there,) = rank([design]).candidates
    (table,) = rank([replace(design, printed_terrain=None)]).candidates
    assert there.design.printed_terrain == design.printed_terrain
    assert there.screened.best != table.screened.best
    assert not np.array_equal(there.spread.displacement, table.spread.displacement)
    assert (drawn_rise(there), drawn_rise(table)) == (pytest.approx(rise(there)), 0.0)
    with raises(InputError, "input.wrong-value", "designs", match="printed_terrain"):
        rank([design, replace(design, printed_terrain=None)])


def drawn_rise(candidate: RankedDesign) -> float:
    """Difference of height along the line under the robot in the shortlist's picture [m]."""
    figure = draw_designs([candidate], [RankingRow.of("design_01.json", candidate, {})])
    _, _, _, surface = figure.axes[0].lines
    return float(np.ptp(surface.get_data()[1]))


def rise(candidate: RankedDesign) -> float:
    """The same of the terrain, 5 % of the robot's length to both sides of it [m]."""
    x, terrain = build(candidate.design.morphology).positions[:, 0], candidate.design.printed_terrain
    assert terrain is not None
    beside = 0.05 * np.ptp(x)
    return float(np.ptp(terrain.outline(x.min() - beside, x.max() + beside)[:, 1]))


def test_a_terrain_file_is_taken_by_both_objectives(tmp_path: Path) -> None:
    """The paper's robot takes a file of the other's size; `run` is the reverse, and the printed robot's own
    is in `test_ground_circle.py`."""
    ground, scale = Terrain.rugged(np.random.default_rng(1)), BuiltParameters().scale
    assert TerrainFile("paper", ground).lengths_of("paper", scale) == ground
    TerrainFile("printed", ground.scaled(scale)).save(tmp_path / "printed.json")
    given = ["--terrain", str(tmp_path / "printed.json"), "--out", str(tmp_path / "run")]
    result = CliRunner().invoke(application(), [*SMALLEST.split(), *given])
    assert result.exit_code == 0, result.output
    scene = RunFolder.open(tmp_path / "run").config.scene
    assert scene.contact == "friction" and np.allclose(scene.terrain.x0, ground.x0, atol=1e-12)
    trained = load_run(tmp_path / "run")[0].printed_terrain
    assert trained is not None and np.allclose(trained.x0, scale * ground.x0, atol=1e-12)


def test_a_name_is_the_same_ground_for_both_objectives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the command makes the run folder; nothing evolves."""
    monkeypatch.setattr("eldir_app.evolution_run.run_evolution", lambda *_, **__: None)
    for name in ("incline", "flat"):
        for evolve in (EVOLVE, SMALLEST.replace("evolve", "evolve --seed 4")):
            out = str(tmp_path / f"{name}-{len(evolve)}")
            result = CliRunner().invoke(application(), [*evolve.split(), "--terrain", name, "--out", out])
            assert result.exit_code == 0, result.output
        printed = PrintedRun.open(tmp_path / f"{name}-{len(EVOLVE)}").config.terrain
        paper = RunFolder.open(Path(out)).config.scene.terrain
        assert paper == make_terrain(name, 4) and paper.is_flat == (printed is None)
        assert printed is None or printed == paper.scaled(BuiltParameters().scale)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "does not exist"),
        ("{}", "eldir-terrain/1"),
        (
            '{"format": "eldir-terrain/1", "robot": "paper", "terrain": {"x0": [0], "slope": [0]}}',
            "intercept",
        ),
        (
            '{"format": "eldir-terrain/1", "robot": "moon", "terrain": '
            '{"x0": [0], "slope": [0], "intercept": [0]}}',
            "'paper' or 'printed'",
        ),
        (
            '{"format": "eldir-terrain/1", "robot": "printed", "terrain": '
            '{"x0": [0, 1], "slope": [25, 25], "intercept": [0, 0]}}',
            "slopes up to 20",
        ),
    ],
)
def test_wrong_terrain_files_are_refused(text: str | None, says: str, tmp_path: Path) -> None:
    if text is not None:
        (tmp_path / "ground.json").write_text(text)
    given = ["--terrain", str(tmp_path / "ground.json"), "--out", str(tmp_path / "run")]
    result = CliRunner().invoke(application(), [*EVOLVE.split(), *given])
    assert result.exit_code == 1 and says in str(result.exception) and not (tmp_path / "run").exists()


def test_an_unknown_ground_is_refused(tmp_path: Path) -> None:
    given = ["--terrain", "moon", "--out", str(tmp_path / "run")]
    result = CliRunner().invoke(application(), [*EVOLVE.split(), *given])
    assert result.exit_code == 2 and "incline" in result.output


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
