"""How long the demo evolves, and which design of a shortlist it builds."""

from types import SimpleNamespace

import numpy as np
import pytest

from eldir.design import marked_masses
from eldir.errors import EldirError
from eldir.evolution.archive import Archive
from eldir.evolution.printed.walker import Niche, Walker
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import develop
from eldir_app import demo
from eldir_app.demo import choose_design, has_good_walker
from eldir_cad.shortlist.ranking import Shortlist
from tests.eldir.evolution.printed.small_searches import genomes
from tests.raised import raises

LATTICE = Lattice(6, 11)
FOUND = [develop(LATTICE, g) for g in random_genotypes(LATTICE, 60, np.random.default_rng(1), 2)]
BODIES = {len(marked_masses(body)): body for body in FOUND}  # one for each number of markers
FIVE_MARKERS = [body for body in FOUND if len(marked_masses(body)) == 5]


@pytest.mark.parametrize(
    ("ranked", "chosen"),
    [
        ([(1.4, 4), (0.3, 5)], 0),
        ([(1.4, 4), (1.2, 5)], 0),
        ([(1.4, 4), (1.3, 5)], 0),
        ([(1.4, 4), (1.34, 5)], 1),
        ([(1.4, 4), (1.38, 4), (1.35, 5)], 2),
        ([(1.4, 5), (1.32, 5)], 0),
        ([(0.0, 4), (-0.1, 5)], 0),
        ([(-0.2, 4), (-0.1, 5)], 0),
        ([(-np.inf, 4)], 0),
    ],
)
def test_marks_are_a_preference_among_those_that_walk_nearly_as_far(ranked, chosen):
    candidates = tuple(
        SimpleNamespace(
            spread=SimpleNamespace(fitness=fitness),
            design=SimpleNamespace(morphology=BODIES[marks]),
            is_doubtful=False,
        )
        for fitness, marks in ranked
    )
    assert all(choose_design(Shortlist(candidates, 9, {}), seed) is candidates[chosen] for seed in range(4))


def test_seeds_select_sizes_in_turn_among_those_that_walk_about_as_far():
    """The smallest body first. The last three walk less, have fewer markers, or a doubtful prediction."""
    large, medium, small = sorted(FIVE_MARKERS, key=lambda body: -len(body.positions))[::20][:3]
    ranked = [(1.5, large), (1.48, small), (1.44, medium), (1.41, small), (1.5, BODIES[4]), (1.6, small)]
    candidates = tuple(
        SimpleNamespace(
            spread=SimpleNamespace(fitness=fitness),
            design=SimpleNamespace(morphology=body),
            is_doubtful=fitness == 1.6,
        )
        for fitness, body in ranked
    )
    chosen = [candidates.index(choose_design(Shortlist(candidates, 9, {}), seed)) for seed in range(6)]
    assert chosen == [1, 2, 0, 1, 2, 0]


def test_without_a_design_it_says_why():
    with raises(EldirError, "shortlist.empty", match="found 9 bodies: 9 mechanism; try another seed"):
        choose_design(Shortlist((), 9, {"mechanism": 9}), 1)


@pytest.mark.parametrize(
    ("walks", "enough"),
    [([1.6] * 32, True), ([1.6] * 24, False), ([1.4] * 32, False), ([1.1, 2.1] * 16, False), ([], False)],
)
def test_a_robot_walks_well_if_it_is_known_to(walks, enough):
    """Too few samples, too short a walk, and one that is far in the mean but not steadily so."""
    walker = Walker(1, -1, 0, genomes(1)[0], Niche(1, 1, 1, 1), np.array(walks))
    assert has_good_walker(Archive([walker])) == enough
    assert not has_good_walker(Archive())


def test_a_demo_without_a_design_names_its_own_remedy(tmp_path, monkeypatch):
    """Not that of `eldir shortlist`, whose options the demo does not have; and nothing is left behind."""
    monkeypatch.setattr(demo, "run_generations", lambda *_: None)  # it always finds some
    monkeypatch.setattr(demo, "load_run", lambda run: [])
    with raises(EldirError, "shortlist.empty", match="found 0 bodies: no designs; try another seed"):
        demo.run_demo(tmp_path / "demo", demo.DemoConfig())
    assert not any(tmp_path.iterdir())
