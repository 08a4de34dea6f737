"""Ask and tell with an injected evaluation: selection, seeds, invalid robots, the accepted bodies."""

import numpy as np
import pytest

from eldir.built.robot import build
from eldir.errors import EldirError, InputError
from eldir.evolution.archive import Archive
from eldir.evolution.paper.configuration import EvolutionConfig, robot_seed
from eldir.evolution.paper.learning import add_outcome
from eldir.evolution.paper.population import is_valid
from eldir.evolution.search import Search
from eldir.morphology import Morphology, develop
from tests.eldir.evolution.pretended_searches import (
    SMALL,
    complete_generation,
    evaluate,
    evolved,
    fitness,
    ids,
    search_for,
)
from tests.raised import raises


def test_fitness_never_falls_and_selection_improves_it():
    search, best, mean = search_for(SMALL), [], []
    while not search.finished:
        complete_generation(search)
        alive = fitness(search)
        assert (np.diff(alive) <= 0).all()
        best.append(alive[0])
        mean.append(alive.mean())
    assert len(best) == SMALL.generations + 1
    assert (np.diff(best) >= 0).all()
    assert (np.diff(mean) >= 0).all()
    assert mean[-1] > mean[0]


def test_the_best_of_parents_and_offspring_are_kept():
    """An independent count: the survivors are the top N of everything ever evaluated."""
    search, everything = search_for(SMALL), []
    while not search.finished:
        everything += [robot.fitness for robot in complete_generation(search).tried]
    assert fitness(search).tolist() == sorted(everything, reverse=True)[: SMALL.population]


def test_parents_are_not_evaluated_again():
    search, seen = search_for(SMALL), []
    while not search.finished:
        seen += [robot.number for robot in search.ask().robots]
        complete_generation(search)
    assert len(seen) == len(set(seen)) == SMALL.population * (SMALL.generations + 1)


def test_same_seed_same_run_and_another_seed_another():
    one, again, other = (
        evolved(SMALL),
        evolved(SMALL),
        evolved(EvolutionConfig.from_json(SMALL.to_json() | {"seed": 6})),
    )
    assert one.archive.ranked() == again.archive.ranked()
    assert one.archive.ranked() != other.archive.ranked()


def test_a_search_goes_on_from_any_generation():
    whole = evolved(SMALL)
    first = search_for(SMALL)
    for _ in range(2):
        complete_generation(first)
    later = Search(first.problem, first.generation, first.archive.ranked())
    while not later.finished:
        complete_generation(later)
    assert later.archive.ranked() == whole.archive.ranked()


def test_seeds_are_distinct_and_do_not_depend_on_the_population():
    seeds = {robot_seed(1, g, i) for g in range(50) for i in range(50)}
    assert len(seeds) == 2500
    assert all(0 <= s < 2**63 for s in seeds)
    few = search_for(SMALL).ask().seeds
    many = search_for(EvolutionConfig.from_json(SMALL.to_json() | {"population": 20})).ask().seeds
    assert few == many[:12]


@pytest.mark.parametrize(
    ("losses", "sound"),
    [
        ([0.0, -0.1, -0.2], True),
        ([0.0, np.nan, -0.2], False),
        ([0.0, -np.inf, -0.2], False),
        ([np.inf, np.inf, -0.2], False),
        ([0.0, -0.6, -0.7], False),
        ([0.0, -0.5, -1.0], True),
        ([0.0, -0.5, 0.1], False),
    ],
)
def test_invalid_robots_are_told_by_their_losses(losses, sound):
    assert is_valid(np.array([losses]), 0.5)[0] == sound


def test_invalid_robots_do_not_survive_and_the_population_recovers():
    search = search_for(SMALL)
    robots = search.ask()
    outcome = evaluate(robots, SMALL)
    outcome.losses[3:, 1] = np.nan
    outcome.losses[0, -1] = -9.0  # a leap, not a walk
    search.tell(robots, add_outcome(robots.robots, outcome))
    assert sorted(ids(search)) == [1, 2]
    while not search.finished:
        complete_generation(search)
    assert len(search.archive) == SMALL.population


def test_equal_robots_keep_the_elder():
    search = search_for(SMALL)
    robots = search.ask()
    outcome = evaluate(robots, SMALL)
    outcome.losses[:] = -0.1
    search.tell(robots, add_outcome(robots.robots, outcome))
    assert ids(search) == list(range(12))
    few = Archive(search.archive.ranked(), 5).ranked()
    assert [robot.number for robot in few] == [0, 1, 2, 3, 4]


def test_a_generation_without_any_sound_robot_is_told():
    search = search_for(SMALL)
    robots = search.ask()
    outcome = evaluate(robots, SMALL)
    outcome.losses[:] = np.nan
    with raises(EldirError, "evolution.none-stable"):
        search.tell(robots, add_outcome(robots.robots, outcome))


@pytest.mark.parametrize("crossover", ["none", "distinct", "joint"])
def test_only_accepted_bodies_live(crossover):
    def small(body: Morphology) -> bool:
        return len(body.positions) <= 10

    config = EvolutionConfig.from_json(SMALL.to_json() | {"crossover": crossover})
    search = evolved(config, accept=small)
    bodies = [develop(config.lattice, robot.genotype) for robot in search.archive.ranked()]
    assert all(small(b) for b in bodies)
    assert all(1 <= b.motors <= 2 for b in bodies)
    with raises(EldirError, "evolution.too-few-bodies"):
        search_for(config, accept=lambda body: False).ask()


def test_only_bodies_that_stand_are_born():
    """The margin by hand: feet are the masses of the lowest row, weights as built."""
    config = EvolutionConfig.from_json(SMALL.to_json() | {"static_margin": 0.02})
    search = search_for(config)
    while not search.finished:
        robots = search.ask()
        for body in robots.bodies:
            robot = build(body)
            x, y = robot.positions.T
            feet = x[y < y.min() + 1e-9]
            centre = np.average(x, weights=robot.masses)
            assert feet.min() + 0.02 <= centre + 1e-9
            assert centre - 1e-9 <= feet.max() - 0.02
        search.tell(robots, add_outcome(robots.robots, evaluate(robots, config)))
    with raises(InputError, "evolution.wrong-value", "static_margin"):
        EvolutionConfig(static_margin=np.nan)


def test_parents_are_named_by_their_ids():
    config = EvolutionConfig.from_json(SMALL.to_json() | {"crossover": "joint"})
    search = search_for(config)
    robots = search.ask()
    assert all(robot.parents == (-1, -1) for robot in robots.robots)
    search.tell(robots, add_outcome(robots.robots, evaluate(robots, config)))
    children = [robot.parents for robot in search.ask().robots]
    assert {parent for pair in children for parent in pair} <= set(ids(search))
    assert any(one != other for one, other in children)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [("population", 0), ("generations", -1), ("max_active", 0), ("crossover", "some"), ("seed", -1)],
)
def test_a_wrong_configuration_is_named(name, wrong):
    with raises(InputError, "evolution.wrong-value", name):
        EvolutionConfig(**{name: wrong})
