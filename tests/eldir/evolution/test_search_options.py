"""Constraints while evolving, inherited weights and the second stage, held by the bodies that come out."""

import numpy as np
import pytest

from eldir.built.robot import build, count_mechanisms, static_margin
from eldir.errors import InputError
from eldir.evolution.designs import load_run
from eldir.evolution.loop import run_generations
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.history import read_history
from eldir.evolution.paper.learning import Shard, add_outcome
from eldir.evolution.paper.run_folder import RunFolder, load_generation
from eldir.evolution.variation import inherit
from eldir.evolution.workers import LocalWorkers
from eldir.lattice import Lattice
from eldir.learning import initial_controllers
from eldir.morphology import develop
from eldir.scene import Scene
from eldir.training.configuration import TrainingConfig
from tests.eldir.evolution.counting_evaluation import Counting
from tests.eldir.evolution.pretended_searches import (
    complete_generation,
    evaluate,
    evolved,
    fitness,
    ids,
    learn,
    search_for,
)
from tests.eldir.evolution.run_folders import contents, go_on
from tests.raised import raises

SMALL = EvolutionConfig(Lattice(4, 6), population=8, generations=3, max_active=2, iterations=3, seed=5)


def changed(**values) -> EvolutionConfig:
    return EvolutionConfig.from_json(SMALL.to_json() | values)


@pytest.mark.parametrize("crossover", ["none", "distinct", "joint"])
def test_no_offspring_exceeds_a_constraint(crossover):
    config = changed(buildable=True, static_margin=0.01, crossover=crossover)
    search = search_for(config)
    while not search.finished:
        robots = search.ask()
        for body in robots.bodies:
            robot = build(body)
            assert 1 <= body.motors <= 2
            assert static_margin(robot) >= 0.01
            assert count_mechanisms(robot.positions, robot.springs) == 0
            assert count_mechanisms(robot.positions, robot.springs[~robot.active]) > 0
        search.tell(robots, add_outcome(robots.robots, evaluate(robots, config)))


def test_without_the_constraint_such_bodies_are_born():
    bodies = search_for(changed(population=60)).ask().bodies
    assert any(count_mechanisms(b.positions, b.springs) for b in bodies)


class Heirs(Counting):
    """Remembers what robots start from."""

    def __init__(self, shards: int = 10**9):
        super().__init__(shards)
        self.shards: list[Shard] = []

    def __call__(self, shards):
        for shard in shards:
            self.shards.append(shard)
            self.left -= 1
            yield shard, learn(shard, SMALL)


def test_offspring_start_from_the_weights_of_their_parent(tmp_path):
    config = changed(inherit=True, crossover="joint", population=12)
    run = RunFolder.create(tmp_path / "run", config)
    search, trainer = run.restore(), Heirs(3)
    run_generations(run, search, trainer, trainer.stopped)
    assert all(shard.controllers is None for shard in trainer.shards)
    parents = {robot.number: robot for robot in search.archive.ranked()}
    trainer, robots = Heirs(3), search.ask()
    run_generations(run, search, trainer, trainer.stopped)
    fresh = initial_controllers(robots.bodies, config.scene, robots.seeds)
    heirs = 0
    for shard in trainer.shards:
        for i, body, start in zip(shard.index, shard.bodies, shard.controllers, strict=True):
            one, other = robots.robots[i].parents
            if one != other:
                assert start == fresh[i]
                continue
            parent = develop(config.lattice, parents[one].genotype)
            assert start == inherit(parent, parents[one].controller, body, fresh[i])
            heirs += 1
    assert heirs > 0


def test_threads_do_not_change_a_run_of_painted_bodies(tmp_path, monkeypatch):
    scene = Scene.preset("paper").replace(steps=30).to_json()
    config = changed(encoding="cppn", crossover="neat", generations=1, inherit=True, scene=scene)
    folders = []
    for threads in ("1", "2"):
        monkeypatch.setenv("ELDIR_THREADS", threads)
        run = RunFolder.create(tmp_path / threads, config)
        run_generations(run, run.restore(), LocalWorkers())
        folders.append(contents(run.path))
    assert folders[0] == folders[1]


@pytest.mark.parametrize("optimiser", ["steps", "adam"])
def test_a_run_with_heirs_goes_on_with_the_same_bytes(tmp_path, optimiser):
    scene = Scene.preset("paper").replace(steps=30, window=10).to_json()
    config = changed(
        inherit=True, scene=scene, training=TrainingConfig(optimiser, 0.2).to_json(), generations=2
    )
    whole = RunFolder.create(tmp_path / "whole", config)
    run_generations(whole, whole.restore(), LocalWorkers())
    parts = RunFolder.create(tmp_path / "parts", config)
    while not (search := parts.restore()).finished:
        run_generations(parts, search, LocalWorkers(), iter([False, True]).__next__)
    assert contents(parts.path) == contents(whole.path)


def walks(bodies):
    """Bodies of an odd number of springs fall over, the others walk by it."""
    return np.array([-np.inf if len(b.springs) % 2 else len(b.springs) / 100 for b in bodies])


def test_the_second_stage_removes_those_that_fall(tmp_path):
    config = changed(second_stage=True, population=20)
    run = RunFolder.create(tmp_path / "run", config)
    search = search_for(config, walks=walks)
    go_on(run, search)
    alive = search.archive.ranked()
    sizes = [len(develop(config.lattice, robot.genotype).springs) for robot in alive]
    assert all(n % 2 == 0 for n in sizes)
    assert [robot.walk for robot in alive] == [n / 100 for n in sizes]
    # Whoever was driven and stands is the best of all that stand.
    born = [load_generation(run.path, g) for g in range(4)]
    driven = np.concatenate([b["walk"] for b in born])
    walked = np.concatenate([-b["losses"].min(axis=1) for b in born])
    assert np.isneginf(driven).any()
    standing = np.sort(walked[np.isfinite(driven)])[::-1]
    assert fitness(search).tolist() == standing[: len(sizes)].tolist()
    assert np.isnan(driven).any()  # not all had to be driven
    assert run.read_last_elites() == alive
    assert [d.provenance["built_walk"] for d in load_run(run.path)] == [robot.walk for robot in alive]
    assert read_history(run).last.ids.tolist() == ids(search)


def test_the_second_stage_drives_each_body_once():
    seen = []

    def count(bodies):
        seen.extend(bodies)
        return walks(bodies)

    evolved(changed(second_stage=True), walks=count)
    assert 0 < len(seen) <= SMALL.population * (SMALL.generations + 1)


def test_the_second_stage_is_the_built_scene():
    """A real robot: by default bodies are driven as `eldir shortlist` does in its first pass."""
    config = changed(
        second_stage=True, static_margin=0.02, buildable=True, population=3, generations=0, seed=2
    )
    search = search_for(config)
    learned = complete_generation(search).tried
    assert None not in [robot.walk for robot in learned]


def test_a_second_stage_with_many_motors_is_refused():
    for most in (None, 4):
        with raises(InputError, "evolution.inconsistent", "EvolutionConfig.max_active"):
            changed(second_stage=True, max_active=most)


def test_old_runs_lack_the_options():
    values = SMALL.to_json()
    for name in ("buildable", "second_stage", "inherit"):
        del values[name]
    assert EvolutionConfig.from_json(values).to_json() == SMALL.to_json()
