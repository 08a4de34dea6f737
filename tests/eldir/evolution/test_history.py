"""A run's history is replayed from its generation files as the search made it."""

from itertools import pairwise

import numpy as np
import pytest

from eldir.errors import InputError
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.history import read_history
from eldir.evolution.paper.learning import add_outcome
from eldir.evolution.paper.run_folder import RunFolder, load_generation
from eldir.lattice import Lattice
from eldir.morphology import develop
from tests.eldir.evolution.pretended_searches import evaluate, fitness, ids
from tests.eldir.evolution.run_folders import go_on
from tests.raised import raises

CONFIG = EvolutionConfig(
    Lattice(4, 6), population=8, generations=5, crossover="distinct", max_active=2, iterations=3, seed=5
)


@pytest.fixture
def run(tmp_path):
    return RunFolder.create(tmp_path / "run", CONFIG)


def test_every_generation_is_replayed(run):
    search, best, mean, initial, sizes = run.restore(), [], [], [], []
    while not search.finished:
        robots = search.ask()
        outcome = evaluate(robots, CONFIG)
        outcome.losses[search.generation, 1] = np.nan  # one is discarded in each
        run.save(search.tell(robots, add_outcome(robots.robots, outcome)))
        alive = search.archive.ranked()
        bodies = [develop(CONFIG.lattice, robot.genotype) for robot in alive]
        best.append(alive[0].fitness)
        mean.append(fitness(search).mean())
        initial.append(-np.mean([robot.losses[0] for robot in alive]))
        sizes.append(np.mean([len(b.springs) for b in bodies]))
    history = read_history(run)
    trend = history.trend
    assert trend.best.tolist() == best
    assert trend.mean == pytest.approx(mean)
    assert trend.mean_initial == pytest.approx(initial)
    assert trend.size == pytest.approx(sizes)
    assert trend.evaluated.tolist() == [8, 7, 8, 8, 8, 8]  # seven were left to have offspring
    assert trend.discarded.tolist() == [1] * 6
    assert len(history.progenitors.ids) == 7
    assert history.last.ids.tolist() == ids(search)
    for i, body in enumerate(bodies):
        assert develop(CONFIG.lattice, history.last.genotype(i)) == body
        assert history.last.active[i] == pytest.approx(body.active.mean())


def test_the_line_goes_from_the_best_to_a_progenitor(run):
    search = go_on(run, run.restore())
    line = read_history(run).line
    assert line[0].ids[0] == ids(search)[0]
    born = [load_generation(run.path, g) for g in range(CONFIG.generations + 1)]
    fitness = {int(i): -x.min() for b in born for i, x in zip(b["id"], b["losses"], strict=True)}
    for child, parent in pairwise(line):
        assert parent.ids[0] in child.parents[0]
        assert fitness[int(parent.ids[0])] == max(fitness[int(i)] for i in child.parents[0])
        assert parent.ids[0] < child.ids[0]
    assert line[-1].parents[0].tolist() == [-1, -1]


def test_a_run_without_a_generation_and_foreign_files_are_named(run, tmp_path):
    with raises(InputError, "run.no-generation"):
        read_history(run)
    go_on(run, run.restore())
    other = RunFolder.create(tmp_path / "other", EvolutionConfig.from_json(CONFIG.to_json() | {"seed": 6}))
    go_on(other, other.restore())
    run.generation_file(2).write_bytes(other.generation_file(3).read_bytes())
    with raises(InputError, "run.broken-history", match="generation-0002"):
        read_history(run)
    run.generation_file(2).write_bytes(b"PAR1")
    with raises(InputError, "file.damaged", match="generation-0002"):
        read_history(run)
