"""Evolution on the paper's lattice, and runs that are killed again and again."""

import time

import numpy as np
import pytest

from eldir.evolution.designs import load_run
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.problem import PaperProblem
from eldir.evolution.paper.run_folder import RunFolder, load_generation
from eldir.evolution.problem import evaluate_here
from eldir.evolution.search import Search
from eldir.lattice import Lattice
from tests.eldir.evolution.evolve_processes import SMALL, contents, start

pytestmark = pytest.mark.stress


@pytest.mark.parametrize("crossover", ["none", "joint", "distinct"])
def test_learning_improves_over_generations_and_few_robots_are_unstable(tmp_path, crossover):
    config = EvolutionConfig(Lattice(), population=48, generations=12, crossover=crossover, seed=2)
    run = RunFolder.create(tmp_path / "run", config)
    search = Search(PaperProblem(config))
    means = []
    while not search.finished:
        batch = search.ask()
        run.save(search.tell(batch, evaluate_here(batch)))
        means.append(np.mean([robot.fitness for robot in search.archive.ranked()]))
    born = [load_generation(run.path, g) for g in range(config.generations + 1)]
    # The paper filters 0.20 % on average and never more than 0.83 %; of 624 robots that is 5.
    assert sum(int((~b["valid"]).sum()) for b in born) <= 5
    assert (np.diff(means) >= 0).all()
    assert means[-1] > 1.5 * means[0]
    # Offspring inherit: those of the last generations learn better than random bodies.
    median = [float(np.median(-b["losses"][b["valid"]].min(axis=1))) for b in born]
    assert np.mean(median[-3:]) > 1.1 * median[0]
    # Robots walk further after learning than before, the more so the later they were born.
    gain = [(b["losses"][:, 0] - b["losses"].min(axis=1))[b["valid"]].mean() for b in born]
    assert min(gain) > 0
    assert len(load_run(run.path)) == config.population


def test_a_run_that_is_killed_again_and_again_ends_with_the_same_bytes(tmp_path):
    generations = ["--generations", "60"]
    assert start("--out", tmp_path / "whole", *generations, *SMALL).wait(timeout=900) == 0
    rng = np.random.default_rng(1)
    process = start("--out", tmp_path / "killed", *generations, *SMALL)
    kills = 0
    while True:
        while not (tmp_path / "killed" / "run.json").exists():
            time.sleep(0.01)
        time.sleep(rng.uniform(0.8, 2.2) + 0.5 * kills)  # longer and longer, for busy machines
        if process.poll() is not None:
            break
        process.kill()
        process.wait()
        kills += 1
        process = start("--resume", tmp_path / "killed")
    assert process.returncode == 0
    assert kills >= 1
    assert contents(tmp_path / "killed") == contents(tmp_path / "whole")


def test_the_first_generation_of_ten_thousand():
    """The paper's 70 000: 176.15 +- 67.79 springs, 0.49 +- 0.04 of them active (bits of probability 1/2)."""
    search = Search(PaperProblem(EvolutionConfig(population=10_000, seed=1)))
    before = time.process_time()
    robots = search.ask()
    drawn = time.process_time()
    bodies = robots.bodies
    developed = time.process_time()
    assert drawn - before < 2.0
    assert developed - drawn < 2.0  # seconds of one core
    sizes = np.array([len(b.springs) for b in bodies])
    active = np.array([b.active.mean() for b in bodies])
    assert sizes.mean() == pytest.approx(176, abs=2)
    assert sizes.std() == pytest.approx(68, abs=2)
    assert active.mean() == pytest.approx(0.5, abs=4 * 0.042 / 100)  # four standard errors
    assert active.std() == pytest.approx(0.04, abs=0.005)
