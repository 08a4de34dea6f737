"""Mirror images and shifted bodies: the same robot, judged by its positions and by how it moves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eldir.built.gait import Gait, free_lengths
from eldir.built.motion import drive
from eldir.built.robot import build
from eldir.evolution.printed.genome import mirror_genome, motor_springs, random_genomes, shift_genome
from eldir.lattice import Lattice
from tests.eldir.evolution.printed.small_searches import SMALL, edges, genomes

LATTICES = st.builds(Lattice, st.integers(1, 5), st.integers(2, 8))
SHIFTS = st.integers(-3, 3)


@given(lattice=LATTICES, seed=st.integers(0, 999))
def test_a_mirror_image_has_all_springs_on_the_other_side(lattice: Lattice, seed: int) -> None:
    (genome,) = random_genomes(lattice, 1, np.random.default_rng(seed), 2, 1)
    image = mirror_genome(lattice, genome)
    body = genome.body(lattice)
    if image is not genome:
        assert edges(image.body(lattice)) == edges(body, -1.0)
        again = mirror_genome(lattice, image)
        assert edges(again.body(lattice)) == edges(body)
    else:
        assert body.body_length > 0.9 * lattice.columns * 0.025, "only a body without room has no image"


@given(lattice=LATTICES, seed=st.integers(0, 999), right=SHIFTS, up=SHIFTS)
def test_a_shifted_body_is_the_same_one_elsewhere(lattice: Lattice, seed: int, right: int, up: int) -> None:
    (genome,) = random_genomes(lattice, 1, np.random.default_rng(seed), 2, 1)
    elsewhere = shift_genome(lattice, genome, right, up)
    if (right + up) % 2:
        assert elsewhere is None, "triangles would stand on their heads"
    elif elsewhere is not None:
        here, there = genome.body(lattice), elsewhere.body(lattice)
        assert edges(there) == edges(here)
        by = lattice.vertices[there.vertices] - lattice.vertices[here.vertices]
        assert (by == [right, up]).all()
        for ends, spring in zip(here.springs.tolist(), here.lattice_springs, strict=True):
            (same,) = np.flatnonzero((there.springs == ends).all(axis=1))
            assert genome.phases[spring] == elsewhere.phases[there.lattice_springs[same]]


def test_what_leaves_the_lattice_is_not_moved() -> None:
    genome = genomes(1)[0]
    assert shift_genome(SMALL.lattice, genome, 0, 0) == genome
    assert shift_genome(SMALL.lattice, genome, 20, 0) is None


@pytest.mark.parametrize("seed", [1, 2])
def test_a_mirror_image_walks_the_other_way(seed: int) -> None:
    """Independent of the code that mirrors: the engine moves both, with the same gait of each motor."""
    genome = genomes(3, seed)[2]
    image = mirror_genome(SMALL.lattice, genome)
    moved_to = []
    for one in (genome, image):
        body = one.body(SMALL.lattice)
        robot = build(body)
        phases = one.phases[motor_springs(body)]  # of both bodies the same motor begins
        gait = Gait(20.0, phases, np.full(len(phases), 0.3))
        table = free_lengths(gait, SMALL.springs, cycles=1, conditioning=0)
        (motion,) = drive([robot], [table.lengths[:161]], table.interval, every=160)
        x = motion.positions[-1, :, 0]
        moved_to.append(np.sort(x - robot.positions[:, 0].max() if one is genome else -x))
    assert moved_to[0] == pytest.approx(moved_to[1], abs=1e-4), "rounding decides when a foot slips"
    assert np.ptp(moved_to[0]) > 0.05
