"""The archive: the best walker of every kind of body, from estimates that get surer."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eldir.evolution.printed.archive import Archive, Walker, niche_of
from eldir.genotype import Genotype
from eldir.lattice import Lattice
from eldir.morphology import develop
from tests.evolution.printed.small import genomes

GENOME = genomes(1)[0]
WALKS = st.lists(st.floats(-3, 3), min_size=2, max_size=8)


def walker(number: int, walks: list[float], niche: tuple[int, int, int] = (1, 1, 1)) -> Walker:
    return Walker(number, -1, 0, GENOME, niche, np.array(walks))


def test_worth_is_the_mean_less_half_a_standard_deviation() -> None:
    one = walker(1, [1.0, 2.0, 3.0, 0.0])
    sd = np.sqrt(((np.array([1.0, 2.0, 3.0, 0.0]) - 1.5) ** 2).sum() / 3)
    assert (one.expected, one.error) == (1.5, pytest.approx(sd / 2))
    assert one.worth == pytest.approx(1.5 - 0.5 * sd)
    assert one.worth < walker(4, [1.4, 1.5, 1.6, 1.3]).worth, "a robot that falls is worth less than its mean"
    assert walker(2, [2.0]).worth == -np.inf, "one sample says nothing about its scatter"
    assert walker(3, []).worth == -np.inf
    assert one.with_walks(np.array([4.0])).walks.tolist() == [1.0, 2.0, 3.0, 0.0, 4.0]


@given(st.lists(st.tuples(WALKS, st.sampled_from([(1, 1, 0), (1, 2, 0), (2, 2, 1)])), max_size=12))
def test_offers_leave_the_best_of_every_kind(offers: list[tuple[list[float], tuple[int, int, int]]]) -> None:
    archive = Archive()
    walkers = [walker(i, walks, niche) for i, (walks, niche) in enumerate(offers)]
    admitted = [archive.offer(w) for w in walkers]
    for niche in {w.niche for w in walkers}:
        alike = [w for w in walkers if w.niche == niche]
        assert archive.incumbent(niche) == max(w.worth for w in alike)
        assert admitted[alike[0].number]
    ranked = [w.worth for w in archive.ranked()]
    assert ranked == sorted(ranked, reverse=True)
    assert archive.incumbent((9, 9, 9)) == -np.inf


def test_an_elite_that_disappoints_loses_its_rank_but_not_what_is_known() -> None:
    archive = Archive()
    lucky, steady = walker(1, [2.0, 2.0]), walker(2, [1.0, 1.1], (2, 2, 2))
    archive.offer(lucky)
    archive.offer(steady)
    archive.update(lucky.with_walks(np.array([0.0, 0.0])))
    assert [w.number for w in archive.ranked()] == [2, 1]
    assert archive.ranked()[1].walks.tolist() == [2.0, 2.0, 0.0, 0.0]
    archive.update(walker(7, [9.0, 9.0], (2, 2, 2)))
    assert archive.incumbent((2, 2, 2)) == steady.worth, "only the elite itself is updated"


def test_kinds_are_rows_length_and_motors_at_the_ground() -> None:
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
    assert niche_of(body) == (1, round(body.body_length / 0.05), 1)
    springs[base[1]] = True
    assert niche_of(develop(lattice, Genotype(triangles, springs)))[2] == 2
