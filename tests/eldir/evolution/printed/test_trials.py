"""Trials: what they simulate, one robot at a time by the functions that everybody uses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eldir.built.gait import Gait, free_lengths
from eldir.built.robot import build, find_shape_fault, height_over_base
from eldir.built.samples import NominalRobots
from eldir.built.walking import displacements
from eldir.evolution.printed.problem import PrintedProblem, is_steady
from eldir.evolution.printed.trials import (
    FRESH,
    LANES,
    Trial,
    compare_gaits,
    count_falls_as_zero,
    evaluate_walks,
    make_screening_trial,
    screen_gaits,
    walk_on_slopes,
)
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop
from eldir.parameters.robot import RobotParameters
from eldir.parameters.tolerances import RigTolerances
from tests.eldir.built.braced_robots import body
from tests.eldir.evolution.printed.small_searches import BODY, GAIT, SMALL, genomes

pytestmark = pytest.mark.slow(30)

NOMINAL = SMALL.nominal
assert NOMINAL.printed.joints == "pins"


def alone(
    body: Morphology,
    gait: Gait,
    nominal: RobotParameters,
    seed: tuple[int, ...],
    cycles: int,
    max_coil_load: float = 1.0,
    tolerances: RigTolerances = RigTolerances(),  # noqa: B008  # frozen
) -> float:
    """The walk of one sample, a coarse robot by itself."""
    sample = NominalRobots(body, nominal, tolerances=tolerances).sample(np.random.default_rng(seed))
    table = free_lengths(gait, sample.motor_springs(body.motors), cycles)
    robot = build(body, sample).coarse()
    free = nominal.free_lengths
    return float(displacements([robot], [table], cycles, free, max_coil_load)[0])


def test_in_the_first_trial_each_gait_has_its_own_sample() -> None:
    trial = make_screening_trial(BODY, GAIT, (5, 6), spread=False)
    walks = screen_gaits([trial], NOMINAL)
    assert walks.shape == (1, LANES)
    for k in (0, 5):
        assert walks[0, k] == pytest.approx(alone(BODY, trial.gaits[k], NOMINAL, (5, 6, k), 1), abs=1e-9)


def test_gaits_around_the_inherited_one_or_over_the_whole_period() -> None:
    near = make_screening_trial(BODY, GAIT, (0,), spread=False).gaits
    assert np.array_equal(near[0].phase, GAIT.phase)
    whole = make_screening_trial(BODY, GAIT, (0,), spread=True).gaits
    turned = (np.array([g.phase[1] for g in whole]) - GAIT.phase[1]) % 1.0
    assert sorted(np.round(turned * 8).astype(int) % 8) == list(range(8))
    assert {g.phase[0] for g in near + whole} == {0.0}


def test_hubs_decide_between_two_gaits_with_the_same_samples() -> None:
    hubs = replace(NOMINAL, printed=NOMINAL.printed.with_hubs())
    other = replace(GAIT, phase=(GAIT.phase + np.array([0.0, 0.5])) % 1.0)
    found = compare_gaits([Trial(BODY, (GAIT, other), (8,))], NOMINAL)
    for g, gait in enumerate((GAIT, other)):
        walks = count_falls_as_zero(np.array([alone(BODY, gait, hubs, (8, k), 1, 0.75) for k in range(4)]))
        assert found[0, g] == pytest.approx(walks.mean(), abs=1e-9)


def test_a_coil_near_its_buckling_load_counts_as_no_walk() -> None:
    """One of two samples of this robot presses a coil beyond 0.75 of what makes it buckle; both stand."""
    lattice = Lattice(3, 6)
    body = develop(lattice, random_genotypes(lattice, 60, np.random.default_rng(3), 2)[45])
    gait = replace(GAIT, phase=np.zeros(2))
    hubs = replace(NOMINAL, printed=NOMINAL.printed.with_hubs())
    up_to_buckling = [alone(body, gait, hubs, (9, k), 1) for k in range(2)]
    assert np.isfinite(up_to_buckling).all()
    assert alone(body, gait, hubs, (9, 1), 1, 0.75) == -np.inf
    assert alone(body, gait, hubs, (9, 0), 1, 0.75) == up_to_buckling[0]
    found = evaluate_walks([Trial(body, (gait,), (9,))], NOMINAL)[0, :2]
    assert found[0] == pytest.approx(up_to_buckling[0], abs=5e-4) and found[0] != 0.0 and found[1] == 0.0


def test_slopes_are_two_degrees_either_way() -> None:
    found = walk_on_slopes([Trial(BODY, (GAIT,), (7,)), Trial(BODY, (GAIT,), (8,))], NOMINAL)
    for column, tilt in enumerate(np.radians([2.0, -2.0])):
        sloping = replace(NOMINAL, printed=replace(NOMINAL.printed, tilt=float(tilt)))
        walks = count_falls_as_zero(np.array([alone(BODY, GAIT, sloping, (8, k), 1, 0.75) for k in range(4)]))
        assert found[1, column] == pytest.approx(walks.mean(), abs=1e-9)
    assert (found[:, 0] > found[:, 1]).all()  # downhill is farther


def test_samples_have_the_tolerances_of_the_rig() -> None:
    """In each kind of trial: with a well-measured rig in an even room they differ less."""
    narrow = RigTolerances(0.01, 0.08, 21.0, 23.0)
    hubs = replace(NOMINAL, printed=NOMINAL.printed.with_hubs())
    (found,) = evaluate_walks([Trial(BODY, (GAIT,), (9,))], NOMINAL, narrow)
    for k in (0, 3):
        walk = count_falls_as_zero(np.array(alone(BODY, GAIT, hubs, (9, k), 1, 0.75, narrow)))
        assert found[k] == pytest.approx(float(walk), abs=1e-9)
    for kind in (screen_gaits, compare_gaits, evaluate_walks, walk_on_slopes):
        trial = Trial(BODY, (GAIT,) * (LANES if kind is screen_gaits else 2), (9,))
        usual, same, other = (kind([trial], NOMINAL, *t) for t in ((), (RigTolerances(),), (narrow,)))
        assert np.array_equal(usual, same) and not np.array_equal(usual, other)


def test_a_further_look_has_fresh_samples() -> None:
    trial = Trial(BODY, (GAIT,), (9,))
    again = replace(trial, first=FRESH)
    first, second = (evaluate_walks([t], NOMINAL)[0] for t in (trial, again))
    both = evaluate_walks([trial, again], NOMINAL)
    assert np.array_equal(both, np.stack([first, second]))
    walked = [
        w for w in np.concatenate([first, second]).round(9) if w != 0
    ]  # 0: fallen, or a coil near its limit
    assert len(walked) >= 4 and len(set(walked)) == len(walked)
    hubs = replace(NOMINAL, printed=NOMINAL.printed.with_hubs())
    k = int(np.flatnonzero(first)[0])
    assert first[k] == pytest.approx(alone(BODY, GAIT, hubs, (9, k), 1, 0.75), abs=1e-9)


def test_a_fall_counts_as_no_walk() -> None:
    assert count_falls_as_zero(np.array([-np.inf, 1.0, -0.5])).tolist() == [0.0, 1.0, -0.5]


def test_a_tilted_table_must_not_change_the_walk_much() -> None:
    """Of robots that walk somehow on a level table, those that a slope stops or drives are left out."""
    bodies = [(g, g.body(SMALL.lattice)) for g in genomes(14, 8)]
    trials = [
        Trial(body, (genome.gait(body, SMALL.timings),), (SMALL.seed, number, 3))
        for number, (genome, body) in enumerate(bodies)
        if PrintedProblem(SMALL).stands(body)
    ]
    walks = walk_on_slopes(trials, SMALL.nominal)
    kept = is_steady(walks)
    assert 0 < kept.sum() < len(trials)
    for steady, (down, up) in zip(kept, walks, strict=True):
        assert steady == (0.7 * down <= up and 0.7 * up <= down and up > 0 and down > 0)


def test_towers_do_not_stand() -> None:
    problem = PrintedProblem(replace(SMALL, lattice=Lattice(6, 11)))
    assert problem.stands(body(*[(row, c) for row in range(2) for c in (3, 4, 5)]))
    tower = body(*[(row, c) for row in range(4) for c in (3, 4, 5)])
    assert height_over_base(build(tower)) == pytest.approx(4 * np.sqrt(3) / 2 / 2) and not find_shape_fault(
        build(tower)
    )
    assert not problem.stands(tower)
