"""Ask and tell with an injected evaluation: selection, seeds, invalid robots, the accepted bodies."""

import numpy as np
import pytest

from eldir.built.robot import build
from eldir.errors import EldirError, InputError
from eldir.evolution.population import is_valid, select
from eldir.evolution.search import EvolutionConfig, Search, robot_seed
from eldir.morphology import Morphology
from tests.eldir.evolution.pretended_searches import SMALL, evaluate, evolved
from tests.raised import raises


def test_fitness_never_falls_and_selection_improves_it():
    search, best, mean = Search(SMALL), [], []
    while not search.finished:
        robots = search.ask()
        search.tell(robots, evaluate(robots, SMALL))
        fitness = search.survivors.fitness()
        assert (np.diff(fitness) <= 0).all()
        best.append(fitness[0])
        mean.append(fitness.mean())
    assert len(best) == SMALL.generations + 1
    assert (np.diff(best) >= 0).all()
    assert (np.diff(mean) >= 0).all()
    assert mean[-1] > mean[0]


def test_the_best_of_parents_and_offspring_are_kept():
    """An independent count: the survivors are the top N of everything ever evaluated."""
    search, everything = Search(SMALL), []
    while not search.finished:
        robots = search.ask()
        everything += search.tell(robots, evaluate(robots, SMALL)).fitness().tolist()
    assert search.survivors.fitness().tolist() == sorted(everything, reverse=True)[: SMALL.population]


def test_parents_are_not_evaluated_again():
    search, seen = Search(SMALL), []
    while not search.finished:
        robots = search.ask()
        seen += robots.ids.tolist()
        search.tell(robots, evaluate(robots, SMALL))
    assert len(seen) == len(set(seen)) == SMALL.population * (SMALL.generations + 1)


def test_same_seed_same_run_and_another_seed_another():
    one, again, other = (
        evolved(SMALL),
        evolved(SMALL),
        evolved(EvolutionConfig.from_json(SMALL.to_json() | {"seed": 6})),
    )
    assert one.survivors == again.survivors
    assert one.survivors != other.survivors


def test_a_search_goes_on_from_any_generation():
    whole = evolved(SMALL)
    first = Search(SMALL)
    for _ in range(2):
        robots = first.ask()
        first.tell(robots, evaluate(robots, SMALL))
    later = Search(SMALL, generation=first.generation, survivors=first.survivors)
    while not later.finished:
        robots = later.ask()
        later.tell(robots, evaluate(robots, SMALL))
    assert later.survivors == whole.survivors


def test_seeds_are_distinct_and_do_not_depend_on_the_population():
    seeds = {robot_seed(1, g, i) for g in range(50) for i in range(50)}
    assert len(seeds) == 2500
    assert all(0 <= s < 2**63 for s in seeds)
    few = Search(SMALL).ask().seeds
    many = Search(EvolutionConfig.from_json(SMALL.to_json() | {"population": 20})).ask().seeds
    assert np.array_equal(few, many[:12])


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
    search = Search(SMALL)
    robots = search.ask()
    outcome = evaluate(robots, SMALL)
    outcome.losses[3:, 1] = np.nan
    outcome.losses[0, -1] = -9.0  # a leap, not a walk
    search.tell(robots, outcome)
    assert sorted(search.survivors.robots.ids) == [1, 2]
    while not search.finished:
        robots = search.ask()
        search.tell(robots, evaluate(robots, SMALL))
    assert len(search.survivors.losses) == SMALL.population


def test_equal_robots_keep_the_elder():
    search = Search(SMALL)
    robots = search.ask()
    outcome = evaluate(robots, SMALL)
    outcome.losses[:] = -0.1
    search.tell(robots, outcome)
    assert select(search.survivors, 5, 0.5).robots.ids.tolist() == [0, 1, 2, 3, 4]


def test_a_generation_without_any_sound_robot_is_told():
    search = Search(SMALL)
    robots = search.ask()
    outcome = evaluate(robots, SMALL)
    outcome.losses[:] = np.nan
    with raises(EldirError, "evolution.none-stable"):
        search.tell(robots, outcome)


@pytest.mark.parametrize("crossover", ["none", "distinct", "joint"])
def test_only_accepted_bodies_live(crossover):
    def small(body: Morphology) -> bool:
        return len(body.positions) <= 10

    config = EvolutionConfig.from_json(SMALL.to_json() | {"crossover": crossover})
    search = evolved(config, accept=small)
    bodies = search.survivors.robots.morphologies(config.lattice)
    assert all(small(b) for b in bodies)
    assert all(1 <= b.motors <= 2 for b in bodies)
    with raises(EldirError, "evolution.too-few-bodies"):
        Search(config, accept=lambda body: False).ask()


def test_only_bodies_that_stand_are_born():
    """The margin by hand: feet are the masses of the lowest row, weights as built."""
    config = EvolutionConfig.from_json(SMALL.to_json() | {"static_margin": 0.02})
    search = Search(config)
    while not search.finished:
        robots = search.ask()
        for body in robots.morphologies(config.lattice):
            robot = build(body)
            x, y = robot.positions.T
            feet = x[y < y.min() + 1e-9]
            centre = np.average(x, weights=robot.masses)
            assert feet.min() + 0.02 <= centre + 1e-9
            assert centre - 1e-9 <= feet.max() - 0.02
        search.tell(robots, evaluate(robots, config))
    with raises(InputError, "evolution.wrong-value", "static_margin"):
        EvolutionConfig(static_margin=np.nan)


def test_parents_are_named_by_their_ids():
    config = EvolutionConfig.from_json(SMALL.to_json() | {"crossover": "joint"})
    search = Search(config)
    robots = search.ask()
    assert (robots.parents == -1).all()
    search.tell(robots, evaluate(robots, config))
    alive = set(search.survivors.robots.ids.tolist())
    children = search.ask()
    assert set(children.parents.ravel().tolist()) <= alive
    assert (children.parents[:, 0] != children.parents[:, 1]).any()


@pytest.mark.parametrize(
    ("name", "wrong"),
    [("population", 0), ("generations", -1), ("max_active", 0), ("crossover", "some"), ("seed", -1)],
)
def test_a_wrong_configuration_is_named(name, wrong):
    with raises(InputError, "evolution.wrong-value", name):
        EvolutionConfig(**{name: wrong})
