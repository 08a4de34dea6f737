"""Many robots in the kernel's arrays, against one robot after the other, value by value."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eldir.engine.grid import FAMILIES, place_on_grids
from eldir.engine.pack import ORIGIN, dtype, pack
from eldir.engine.threads import for_each
from eldir.engine.validity import max_speeds
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import Bodies, Morphology, develop_all
from eldir.scene import Scene
from eldir.training.loop import initial_controllers
from tests.eldir.engine.random_robots import WEIGHTS
from tests.eldir.random_physics import PAPER, RUGGED, drawn

SCENES = {
    "paper": Scene.preset("paper"),
    "centre and rest": PAPER.replace(sensing="centre-and-rest"),
    "rugged": RUGGED.replace(contact="friction", integrator="second-order"),
    "released": Scene.preset("released-main"),
}
MANY = st.builds(Lattice, st.integers(1, 13), st.integers(1, 22))


def bodies_on(lattice: Lattice, n: int, seed: int) -> list[Morphology]:
    return develop_all(lattice, random_genotypes(lattice, n, np.random.default_rng(seed)))


@settings(max_examples=25, deadline=None)
@given(MANY, st.sampled_from(sorted(SCENES)), st.integers(1, 9), st.integers(0, 2**32 - 1))
def test_every_value_of_every_robot_lies_in_its_place(lattice: Lattice, name: str, n: int, seed: int) -> None:
    scene, robots = SCENES[name], bodies_on(lattice, n, seed)
    robots[0] = replace(robots[0], positions=robots[0].positions + np.array([0.0, 0.02]))  # above the ground
    brains, physics = initial_controllers(robots, scene, seed), [drawn(b, scene, seed) for b in robots]
    batch = pack(robots, brains, scene, physics)
    real = dtype(scene)
    for r, (body, own, brain) in enumerate(zip(robots, physics, brains, strict=True)):
        (grid,), size = place_on_grids(Bodies([body])), batch.sizes[r]
        count, reach = size.cells, grid.reach
        assert [int(c[r]) for c in batch.counts] == [len(body.positions), body.motors, count, reach]
        assert grid.cell_count <= count < grid.cell_count + 16
        start, reference, velocity, rest, stiffness = (
            getattr(batch, key)[k * batch.cell_at[r] : k * batch.cell_at[r + 1]].reshape(k, -1).copy()
            for key, k in (
                ("start", 2), ("reference", 2), ("velocity", 2),
                ("rest_length", FAMILIES), ("stiffness_dt", FAMILIES),
            )
        )  # fmt: skip
        x = body.positions.copy()
        x[:, 1] += max((scene.terrain.height(x[:, 0]) - x[:, 1]).max(), 0.0)
        seen = x - ORIGIN - (x - ORIGIN).mean(axis=0)
        cells = batch.cell[batch.mass_at[r] : batch.mass_at[r + 1]].tolist()
        assert cells == grid.cell.tolist() + [count - 1] * (len(cells) - len(x))
        mask = np.zeros(count)
        for m, cell in enumerate(grid.cell):
            assert np.array_equal(start[:, cell], (x[m] - ORIGIN).astype(real))
            assert np.array_equal(velocity[:, cell], own.velocities[m].astype(real))
            if scene.sensing == "centre-and-rest":
                assert np.allclose(reference[:, cell], seen[m], rtol=0, atol=np.finfo(real).eps)
                reference[:, cell] = 0
            mask[cell], start[:, cell], velocity[:, cell] = 1, 0, 0
        assert not start.any() and not velocity.any() and not reference.any()
        assert np.array_equal(batch.mask[batch.cell_at[r] : batch.cell_at[r + 1]], mask)
        scheme, motors = scene.scheme_at(own.damping), []
        for s, (a, b) in enumerate(body.springs):
            family, first = grid.family[s], grid.first[s]
            ends = {int(first), int(first) + (1, reach, reach + 1)[family]}
            assert ends == {int(grid.cell[a]), int(grid.cell[b])}
            assert rest[family, first] == real(own.rest_lengths[s])
            assert stiffness[family, first] == real(own.stiffness[s] * scheme.force)
            rest[family, first] = stiffness[family, first] = 0
            motors += [family * count + first] * int(body.active[s])
        assert not rest.any() and not stiffness.any()
        listed = batch.motor[batch.motor_at[r] : batch.motor_at[r + 1]].tolist()
        assert listed == motors + [count - 1] * (len(listed) - len(motors))
        speed = max_speeds(Bodies([body]), scene, [own])[0]
        scalars = np.array([scheme.decay, own.gravity * scheme.gravity, own.friction, speed**2])
        assert np.array_equal(batch.scalars.reshape(-1, 4)[r], scalars.astype(real))
        weights = batch.weights[batch.weight_at[r] : batch.weight_at[r + 1]].reshape(-1, 32)
        assert np.array_equal(weights[:10], brain.w1[:, :10].T.astype(real))
        assert np.array_equal(weights[16 : 6 + brain.w1.shape[1]], brain.w1[:, 10:].T.astype(real))
        assert np.count_nonzero(weights) == np.count_nonzero(np.float32(brain.flat))


@pytest.mark.parametrize("name", sorted(SCENES))
def test_weights_come_back(name: str) -> None:
    scene, robots = SCENES[name], bodies_on(Lattice(6, 11), 70, 1)
    brains = initial_controllers(robots, scene, 3)
    batch = pack(robots, brains, scene, [drawn(b, scene, 1) for b in robots])
    for given_, found in zip(brains, batch.controllers(batch.weights), strict=True):
        for key in WEIGHTS:
            same = getattr(given_, key).astype(dtype(scene)).astype(np.float64)
            assert np.array_equal(getattr(found, key), same) and not getattr(found, key).flags.writeable


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(MANY, st.integers(0, 2**32 - 1)), min_size=1, max_size=6))
def test_bodies_of_different_lattices_are_placed_together_as_alone(
    drawn_: list[tuple[Lattice, int]],
) -> None:
    robots = [body for lattice, seed in drawn_ for body in bodies_on(lattice, 2, seed)]
    for body, grid in zip(robots, place_on_grids(Bodies(robots)), strict=True):
        (alone,) = place_on_grids(Bodies([body]))
        assert all(np.array_equal(a, b) for a, b in zip(grid, alone, strict=True))


def test_a_result_does_not_depend_on_the_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    robots, found = bodies_on(Lattice(6, 11), 130, 2), []
    for threads in ("1", "3"):
        monkeypatch.setenv("ELDIR_THREADS", threads)
        found.append(initial_controllers(robots, PAPER, 5))
        assert for_each(lambda r: r, 130) == list(range(130))
    assert found[0] == found[1]
