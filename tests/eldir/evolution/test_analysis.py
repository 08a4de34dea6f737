"""`eldir analyse` of a small real run: figures that can be seen, numbers that are right."""

import csv
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from lxml import etree

from eldir.controller import Controller
from eldir.errors import EldirError
from eldir.evolution import figures
from eldir.evolution.best_walks import BestWalk, choose_generations, draw_walks, trained_walks
from eldir.evolution.loop import run_generations
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.history import read_history
from eldir.evolution.paper.run_folder import RunFolder, load_generation
from eldir.evolution.workers import LocalWorkers
from eldir.genotype import Genotype
from eldir.lattice import Lattice
from eldir.learning import learning_paths
from eldir.morphology import develop
from eldir.rollout import simulate
from eldir.scene import Scene
from eldir.terrain import Terrain
from eldir_app.commands.analyse import analyse
from tests.phone_screen import BROWSER, measured
from tests.raised import raises

SCENE = Scene.preset("paper").replace(steps=60, terrain=Terrain.rugged(np.random.default_rng(1), 0.2))
CONFIG = EvolutionConfig(Lattice(4, 6), population=10, generations=3, iterations=4, seed=2, scene=SCENE)
FIGURES = ["best", "population", "size-and-fitness", "bodies", "zoo", "best-walks", "learning", "lineage"]


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> RunFolder:
    run = RunFolder.create(tmp_path_factory.mktemp("analysis") / "run", CONFIG)
    run_generations(run, run.restore(), LocalWorkers())
    return run


@pytest.fixture(scope="module")
def analysed(run) -> Path:
    analyse(run.path, run.path.parent / "figures")
    return run.path.parent / "figures"


def table(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


def test_every_figure_is_drawn(analysed):
    page = (analysed / "index.html").read_text()
    linked = set(re.findall(r'(?:src|href)="([^"]+)"', page))
    assert {f"{name}.svg" for name in FIGURES} <= linked
    assert all((analysed / name).exists() for name in linked)
    for name in FIGURES:
        assert etree.parse(analysed / f"{name}.svg").getroot().tag.endswith("svg")
        assert cv2.imread(str(analysed / f"{name}.png")).std() > 3
    written = {p.name for p in analysed.iterdir()}
    assert written == linked | {f"{n}.png" for n in FIGURES} | {"index.html"}


def drawn_ticks(axis) -> list[float]:
    low, high = sorted(axis.get_view_interval())
    return [t for t in axis.get_majorticklocs() if low <= t <= high]


def test_figures_of_small_runs_can_be_read(run):
    history = read_history(run)
    some = replace(history.trend, discarded=history.trend.evaluated // 2)
    (axes,) = figures.discarded(some).axes
    assert axes.get_ylim()[0] == 0 and axes.get_ylim()[1] > 50 and not axes.texts
    (axes,) = figures.size_and_fitness(history.progenitors, 0.1).axes
    assert axes.collections[0].get_sizes()[0] > 30 and axes.collections[0].get_alpha() > 0.8
    figure = figures.bodies(history.trend)
    figure.draw_without_rendering()
    axes = figure.axes[0]
    legend, plotted = (one.get_window_extent() for one in (axes.get_legend(), axes))
    assert legend.y0 >= plotted.y1, "it covers no line"
    _, axes = figures.chart("generation", "walk")
    axes.plot([2], [1.0], "o")
    assert drawn_ticks(axes.xaxis) == [2]


def test_the_best_robots_walk_again_as_they_learned(run):
    """Bodies of the figure are those of the run, and their walks its fitness."""
    walks = trained_walks(read_history(run))
    assert [walk.generation for walk in walks] == [0, 1, 2, 3]
    for walk, best in zip(walks, read_history(run).trend.best, strict=True):
        walked = np.ptp(walk.positions[[0, -1]].mean(axis=1)[:, 0])
        assert walk.result == f"{best:+.2f} m" and walked == pytest.approx(best, abs=1e-5)


def test_a_walk_is_drawn_as_high_above_level_ground_as_it_is(run):
    body, scene = trained_walks(read_history(run))[0].body, Scene()
    controller = Controller.random(len(body.positions), body.motors, np.random.default_rng(1))
    (rollout,) = simulate([body], [controller], scene)
    height = scene.terrain.height(np.zeros(1))
    assert scene.terrain.is_flat and rollout.positions[0, :, 1].min() == pytest.approx(height, abs=0.01)
    (axes,) = draw_walks([BestWalk(0, "", body, rollout.positions)], scene.terrain).axes
    ground, path = (line.get_ydata() for line in axes.lines)
    np.testing.assert_allclose(path - ground[0], rollout.positions.mean(axis=1)[:, 1] - height, atol=1e-6)


def test_every_ten_generations_are_chosen_and_the_last():
    assert choose_generations(0) == [0] and choose_generations(7) == [0, 3, 6, 7]
    assert choose_generations(34) == [0, 10, 20, 30, 34]
    assert choose_generations(1000) == list(range(0, 1001, 100))
    assert all(len(choose_generations(last)) <= 12 for last in range(300))


def test_what_has_nothing_to_show_is_left_out_and_told(run, tmp_path):
    """A run of one generation whose weights are inherited: no line has two points, no robot can be trained
    again."""
    first = RunFolder.create(tmp_path / "run", replace(CONFIG, generations=0, inherit=True))
    run_generations(first, first.restore(), LocalWorkers())
    analyse(first.path, tmp_path / "figures")
    assert {p.stem for p in (tmp_path / "figures").glob("*.png")} == {"size-and-fitness", "zoo"}
    page = " ".join((tmp_path / "figures/index.html").read_text().split())
    said = page.split("Not drawn: ")[1].split("</p>")[0].split("; ")
    assert len(said) == 4 and all(": " in one for one in said) and "one is complete" in said[0]


def test_the_page_says_what_cannot_be_compared_with_the_paper(analysed):
    page = " ".join((analysed / "index.html").read_text().split())
    assert "This run's lattice has 4 x 6: numbers of springs cannot be compared with the paper's" in page


@pytest.mark.skipif(BROWSER is None, reason="Chromium is not installed")
def test_the_last_column_is_seen_on_a_phone(analysed, tmp_path):
    found = measured(analysed / "index.html", 390, tmp_path, "1000th")
    assert len(found["heads"]) == 2 and max(found["heads"]) <= found["width"]


def test_numbers_are_those_of_the_run(run, analysed):
    first = load_generation(run.path, 0)
    sound = first["valid"]
    rows = table(analysed / "progenitors.csv")
    assert [int(r["id"]) for r in rows] == first["id"][sound].tolist()
    fitness = -first["losses"][sound].min(axis=1)
    assert [float(r["fitness_m"]) for r in rows] == pytest.approx(fitness, rel=1e-6)
    trend = table(analysed / "generations.csv")
    assert len(trend) == CONFIG.generations + 1
    assert float(trend[0]["best"]) == pytest.approx(fitness.max(), rel=1e-6)
    # Spearman's coefficient is Pearson's of the ranks, equal ones sharing theirs.
    sizes = np.array([int(r["springs"]) for r in rows])
    ranks = [[((v < x).sum() + (v <= x).sum() - 1) / 2 for x in v] for v in (sizes, fitness)]
    (found,) = table(analysed / "correlation.csv")
    assert float(found["spearman_rho"]) == pytest.approx(np.corrcoef(ranks)[0, 1], rel=1e-5)
    sizes_told = next(r for r in table(analysed / "tables.csv") if r["robots"] == "All")
    assert sizes_told["first_generation"] == f"{sizes.mean():.2f} (± {sizes.std():.2f} SD)"


def test_paths_are_of_the_very_rollouts_that_were_learned_from(run):
    born = load_generation(run.path, 0)
    for i in range(3):
        body = develop(CONFIG.lattice, _genotype(born, i))
        paths = learning_paths(body, SCENE, CONFIG.iterations, [int(born["seed"][i])], every=7)
        assert paths.shape == (5, 10, 2)
        assert paths[:, -1, 0] - paths[:, 0, 0] == pytest.approx(-born["losses"][i], abs=1e-6)


def _genotype(born, i):
    return Genotype(born["triangles"][i], born["springs"][i])


def test_the_same_run_gives_the_same_bytes(run, analysed, tmp_path):
    analyse(run.path, tmp_path / "again")
    for path in analysed.iterdir():
        assert (tmp_path / "again" / path.name).read_bytes() == path.read_bytes(), path.name
    with raises(EldirError, "file.exists"):
        analyse(run.path, tmp_path / "again")
