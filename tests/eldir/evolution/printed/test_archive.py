"""The archive: the best walker of every kind of body, from estimates that get surer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eldir.core.records import FloatArray
from eldir.evolution.archive import Archive
from eldir.evolution.printed.problem import PrintedProblem, alternate_sizes, choose_promising
from eldir.evolution.printed.walker import Niche, Walker, find_niche, group_by_size
from eldir.evolution.problem import Batch
from eldir.evolution.search import Search
from eldir.genotype import Genotype
from eldir.lattice import Lattice
from eldir.morphology import develop
from tests.eldir.evolution.printed.small_searches import LATTICE, SMALL, genomes, run_to_end

GENOME = genomes(1)[0]
KINDS = [Niche(1, 1, 1, 0), Niche(1, 2, 1, 0), Niche(1, 2, 2, 0)]
KIND = Niche(1, 1, 1, 1)
WALKS = st.lists(st.floats(-3, 3), min_size=2, max_size=8)


def walker(number: int, walks: list[float], niche: Niche = KIND) -> Walker:
    return Walker(number, -1, 0, GENOME, niche, np.array(walks))


def at_home(one: Walker) -> Walker:
    """The walker in the niche of its own body."""
    return replace(one, niche=find_niche(one.genome.body(LATTICE)))


def elite_of(archive: Archive[Walker], niche: Niche) -> Walker | None:
    return next((one for one in archive.ranked() if one.niche == niche), None)


def test_worth_is_the_mean_less_half_a_standard_deviation() -> None:
    one = walker(1, [1.0, 2.0, 3.0, 0.0])
    sd = np.sqrt(((np.array([1.0, 2.0, 3.0, 0.0]) - 1.5) ** 2).sum() / 3)
    assert (one.expected, one.error) == (1.5, pytest.approx(sd / 2))
    assert one.fitness == pytest.approx(1.5 - 0.5 * sd)
    assert one.fitness < walker(4, [1.4, 1.5, 1.6, 1.3]).fitness, "a fall lowers the fitness"
    assert walker(2, [2.0]).fitness == -np.inf, "one sample says nothing about its scatter"
    assert walker(3, []).fitness == -np.inf
    assert one.with_walks(np.array([4.0])).walks.tolist() == [1.0, 2.0, 3.0, 0.0, 4.0]


@given(st.lists(st.tuples(WALKS, st.sampled_from(KINDS)), max_size=12))
def test_offers_leave_the_best_that_is_known_as_well(
    offers: list[tuple[list[float], Niche]],
) -> None:
    archive = Archive()
    for number, (walks, niche) in enumerate(offers):
        before, offered = elite_of(archive, niche), walker(number, walks, niche)
        admitted = archive.offer(offered)
        after = elite_of(archive, niche)
        assert after is (offered if admitted else before)
        if before is None:
            assert admitted
        else:
            assert admitted == (offered.fitness > before.fitness and len(walks) >= len(before.walks))
            assert len(after.walks) >= len(before.walks) and after.fitness >= before.fitness
    ranked = [w.fitness for w in archive.ranked()]
    assert ranked == sorted(ranked, reverse=True)
    assert archive.incumbent(Niche(9, 9, 9, 9)) == -np.inf


@pytest.mark.parametrize("later, displaces", [(1.3, False), (1.9, True)])
def test_a_lucky_first_look_does_not_displace_what_many_samples_have_shown(
    later: float, displaces: bool
) -> None:
    """Eight samples of 2.0 against 32 of 1.5: the newcomer is looked at again until it is known as well."""
    elite = at_home(walker(1, [1.4, 1.6] * 16))
    newcomer = at_home(walker(2, [2.0] * 8))
    asked: list[int] = []

    def answer(batch: Batch) -> FloatArray:
        asked.extend(trial.first for trial in batch.tasks)
        return np.full((len(batch), 8), later)

    search = Search(PrintedProblem(SMALL), elites=[elite])
    assert run_to_end(search.admit([newcomer]), answer) == displaces
    inside = elite_of(search.archive, elite.niche)
    assert inside is not None and (inside.number, len(inside.walks)) == (2 if displaces else 1, 32)
    assert asked == ([8, 16, 24] if displaces else [8, 16]), "no longer than it may still be better"


def test_newcomers_of_one_kind_are_compared_with_each_other_too() -> None:
    """The second is better than the elite, but the first, which has entered, is better still."""
    elite = at_home(walker(1, [1.0, 1.1] * 4))
    best, second = at_home(walker(2, [1.8, 1.9] * 4)), at_home(walker(3, [1.5, 1.6] * 4))
    search = Search(PrintedProblem(SMALL), elites=[elite])
    assert run_to_end(search.admit([best, second])) == 1
    assert [w.number for w in search.archive.ranked()] == [2]


def test_half_of_the_evaluations_go_to_the_farthest_and_the_others_to_sizes_in_turn() -> None:
    """Robots 0 and 1 walk far but not as far as their elites; 3 to 5 are of new niches."""
    walks = np.array([2.5, 2.2, 2.1, 1.2, 0.9, 0.8, 2.0])
    elites = np.array([2.6, 2.3, 1.9, 0.0, 0.0, 0.0, 1.7])
    sizes = [8, 8, 8, 8, 9, 12, 8]
    assert choose_promising(walks, elites, sizes, 4, 2) == [2, 6, 3, 4]
    assert choose_promising(walks, elites, sizes, 4, 1) == [2, 6, 4, 5]
    assert choose_promising(walks, elites, sizes, 5, 0) == [2, 4, 5, 6, 3]
    assert choose_promising(walks, np.full(7, 9.0), sizes, 2, 2) == [0, 1], "none beats its elite"
    assert sorted(choose_promising(walks, elites, sizes, 9, 4)) == list(range(7))


@given(st.lists(st.integers(3, 6), max_size=12))
def test_the_best_of_each_size_comes_before_the_second_of_any(sizes: list[int]) -> None:
    order = alternate_sizes(sizes)
    assert sorted(order) == list(range(len(sizes)))
    places = [(sizes[:i].count(sizes[i]), i) for i in order]
    assert places == sorted(places)


def test_sizes_that_walk_nearly_as_far_share_the_offspring() -> None:
    """Bodies of 7 and 9 hubs; those of 12 walk less than 0.7 of the best."""
    elites = [
        walker(1, [2.0, 2.0], Niche(2, 2, 8, 1)),
        walker(2, [1.0, 1.0], Niche(2, 2, 8, 2)),
        walker(3, [1.5, 1.5], Niche(2, 2, 9, 1)),
        walker(4, [1.3, 1.3], Niche(3, 2, 12, 1)),
    ]
    assert [[w.number for w in own] for own in group_by_size(Archive(elites).ranked(), 0.7)] == [[1, 2], [3]]
    assert len(group_by_size(elites, 0.0)) == 3
    falls = [walker(5, [-1.0, -1.0])]
    assert group_by_size(falls, 0.7) == [falls], "the best one always counts"


def test_an_elite_that_disappoints_loses_its_rank_but_not_what_is_known() -> None:
    archive = Archive()
    lucky, steady = walker(1, [2.0, 2.0]), walker(2, [1.0, 1.1], Niche(2, 2, 1, 2))
    archive.offer(lucky)
    archive.offer(steady)
    archive.update(lucky.with_walks(np.array([0.0, 0.0])))
    assert [w.number for w in archive.ranked()] == [2, 1]
    assert archive.ranked()[1].walks.tolist() == [2.0, 2.0, 0.0, 0.0]
    archive.update(walker(7, [9.0, 9.0], Niche(2, 2, 1, 2)))
    assert archive.incumbent(Niche(2, 2, 1, 2)) == steady.fitness, "only the elite itself is updated"


def test_kinds_are_rows_length_masses_and_motors_at_the_ground() -> None:
    lattice = Lattice(2, 5)
    triangles = np.zeros((2, 5), bool)
    triangles[0] = True
    springs = np.zeros(len(lattice.springs), bool)
    low = lattice.vertices[lattice.springs][..., 1] == 0
    expressed = lattice.expressed_springs(triangles)
    base = np.flatnonzero(low.all(axis=1) & expressed)
    top = np.flatnonzero(~low.any(axis=1) & expressed)
    springs[[base[0], top[0]]] = True
    body = develop(lattice, Genotype(triangles, springs))
    assert find_niche(body) == (1, round(body.body_length / 0.05), len(body.positions), 1)
    springs[base[1]] = True
    assert find_niche(develop(lattice, Genotype(triangles, springs))).grounded == 2
