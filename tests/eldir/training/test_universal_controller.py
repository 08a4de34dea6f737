"""The study of one controller for all bodies (`examples/pretraining`): what makes it universal, its gradient,
and that it runs."""

import importlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import eldir
from eldir.genotype import repair_bodies
from tests.paths import ROOT

LATTICE = eldir.Lattice(6, 11)
MODULES = ("universal", "training", "evolution", "study")


@pytest.fixture(scope="module")
def example() -> Iterator[dict[str, ModuleType]]:
    """Its modules, which import each other as scripts of one folder do."""
    folder = str(ROOT / "examples" / "pretraining")
    sys.path.insert(0, folder)
    try:
        yield {name: importlib.import_module(name) for name in MODULES}
    finally:
        sys.path.remove(folder)
        for name in MODULES:
            sys.modules.pop(name, None)


@pytest.fixture
def shared(example):
    """A universal controller with random weights everywhere, also where pretraining starts from zeros."""
    rng = np.random.default_rng(4)
    weights = example["universal"].UniversalController.random(rng)
    return weights.shaped(weights.flat + 0.1 * rng.standard_normal(len(weights.flat)))


def _genotypes(n: int, seed: int = 1) -> list[eldir.Genotype]:
    return eldir.random_genotypes(LATTICE, n, np.random.default_rng(seed))


def _bodies(n: int, seed: int = 1) -> list[eldir.Morphology]:
    return [eldir.develop(LATTICE, g) for g in _genotypes(n, seed)]


def _rows(body: eldir.Morphology, controller: eldir.Controller) -> dict[int, np.ndarray]:
    """The output weights of each motor, by its lattice spring."""
    motors = body.lattice_springs[body.active].tolist()
    return dict(zip(motors, np.column_stack([controller.w2, controller.b2]), strict=True))


def test_what_acts_elsewhere_does_not_change_a_cells_weights(shared) -> None:
    """The same cells of robots with other motors sense and act with the same weights."""
    for genotype in _genotypes(5):
        body = eldir.develop(LATTICE, genotype)
        springs = genotype.springs.copy()
        springs[body.lattice_springs[::3]] ^= True
        springs[body.lattice_springs[1]] = True
        other = eldir.develop(LATTICE, eldir.Genotype(genotype.triangles, springs))
        one, changed = shared.controller(body), shared.controller(other)
        assert np.array_equal(one.w1, changed.w1)
        before, after = _rows(body, one), _rows(other, changed)
        common = before.keys() & after.keys()
        assert common
        assert before.keys() != after.keys()
        for spring in common:
            np.testing.assert_allclose(before[spring], after[spring], rtol=1e-12, atol=1e-12)


def test_a_cell_far_from_a_new_triangle_keeps_its_weights(shared) -> None:
    """A triangle that leaves length, height and feet as they are changes only the cells beside it."""
    triangles = np.zeros((6, 11), bool)
    triangles[:, 2:9] = True
    triangles[2:5, 8] = False  # a notch at the front
    genotype = eldir.Genotype(repair_bodies(LATTICE, triangles[None])[0], np.ones(len(LATTICE.springs), bool))
    filled = triangles.copy()
    filled[4, 8] = True
    other = eldir.Genotype(repair_bodies(LATTICE, filled[None])[0], genotype.springs)
    body, larger = eldir.develop(LATTICE, genotype), eldir.develop(LATTICE, other)
    assert len(larger.springs) > len(body.springs)
    assert np.array_equal(np.ptp(body.positions, axis=0), np.ptp(larger.positions, axis=0))
    before, after = _rows(body, shared.controller(body)), _rows(larger, shared.controller(larger))
    changed = [s for s in before if not np.allclose(before[s], after[s], rtol=1e-12, atol=1e-12)]
    new = set(larger.vertices[larger.springs[~np.isin(larger.lattice_springs, body.lattice_springs)]].ravel())
    assert all(new & set(LATTICE.springs[s].tolist()) for s in changed)
    assert len(changed) < len(before) / 3


def test_a_moved_body_has_the_same_controller(shared) -> None:
    """Also on a larger lattice."""
    for genotype in _genotypes(5):
        triangles = np.zeros((10, 15), bool)
        triangles[2:8, 2:13] = genotype.triangles
        wide = eldir.Lattice(10, 15)
        body = eldir.develop(LATTICE, genotype)
        moved = eldir.develop(wide, eldir.Genotype(triangles, np.ones(len(wide.springs), bool)))
        all_act = eldir.Genotype(genotype.triangles, np.ones(len(LATTICE.springs), bool))
        there, here = shared.controller(moved), shared.controller(eldir.develop(LATTICE, all_act))
        np.testing.assert_allclose(body.positions, moved.positions, atol=1e-12)
        np.testing.assert_allclose(here.flat, there.flat, atol=1e-12)


def test_front_and_rear_are_exchanged_in_a_mirror_image(example, shared) -> None:
    """Features of an odd number of half waves along the body change their sign, rising springs fall. The
    controller is another one: it walks to the front in both."""
    features = example["universal"].features
    length_waves = np.array([i for i, _ in example["universal"].COSINES])
    sign = (-1.0) ** np.concatenate([length_waves, length_waves[:4], length_waves[:4]])
    acting = np.ones(len(LATTICE.springs), bool)
    for genotype in _genotypes(5):
        body = eldir.develop(LATTICE, eldir.Genotype(genotype.triangles, acting))
        image = eldir.develop(LATTICE, eldir.Genotype(genotype.triangles[:, ::-1].copy(), acting))
        (masses, motors), (seen, seen_motors) = features(body), features(image)
        width = body.positions[:, 0].min() + body.positions[:, 0].max()

        def order(places: np.ndarray) -> np.ndarray:
            return np.lexsort(np.rint(1e6 * places).T)

        mirrored = body.positions * [-1, 1] + [width, 0]
        np.testing.assert_allclose(masses[order(mirrored)] * sign, seen[order(image.positions)], atol=1e-9)
        middles, found = (b.positions[b.motor_hubs].mean(axis=1) for b in (body, image))
        by_direction = motors.reshape(len(motors), 3, -1)[order(middles * [-1, 1] + [width, 0])]
        exchanged = (by_direction * sign)[:, ::-1]
        np.testing.assert_allclose(exchanged.reshape(motors.shape), seen_motors[order(found)], atol=1e-9)
        if body.body_key != image.key:
            assert not np.allclose(
                shared.controller(body).b2[order(middles)], shared.controller(image).b2[order(found)]
            )


@pytest.mark.slow
def test_the_gradient_of_the_shared_weights_agrees_with_finite_differences(shared) -> None:
    """In float64, summed over bodies of different sizes, along random directions within each array."""
    scene = eldir.Scene.preset("paper").replace(steps=60, precision="f64")
    bodies = _bodies(3, seed=8)

    def losses(weights):
        return eldir.loss_and_gradient(bodies, [weights.controller(b) for b in bodies], scene)

    _, gradients = losses(shared)
    gradient = sum(shared.gradient(b, g).flat for b, g in zip(bodies, gradients, strict=True))
    rng, step, first = np.random.default_rng(2), 1e-6, 0
    for name in ("waves", "hidden", "sense", "act", "bias"):
        size = getattr(shared, name).size
        direction = np.zeros_like(gradient)
        direction[first : first + size] = rng.standard_normal(size)
        first += size
        ahead, behind = (losses(shared.shaped(shared.flat + s * step * direction))[0] for s in (1, -1))
        slope = (ahead.sum() - behind.sum()) / (2 * step)
        assert abs(slope) > 1e-8, name
        np.testing.assert_allclose(gradient @ direction, slope, rtol=2e-5, atol=1e-9, err_msg=name)
    assert first == len(gradient)


@pytest.mark.slow
def test_training_lowers_the_loss_of_its_bodies(example, shared) -> None:
    bodies = _bodies(8)
    trainer = example["training"].Trainer(shared, 0.02)
    before = example["training"].walks(trainer.controller, bodies).mean()
    for _ in range(15):
        trainer.update(bodies)
    assert example["training"].walks(trainer.controller, bodies).mean() > before


@pytest.mark.parametrize("updates", [0, 1])
def test_only_fine_tuning_changes_the_controller(example, shared, updates: int) -> None:
    """The fitness of all survivors is that of the last controller."""
    trainer = example["training"].Trainer(shared, 0.01)
    problem = example["evolution"].UniversalProblem(trainer, LATTICE, 6, 2, updates, seed=1)
    generations = list(example["evolution"].run(eldir.evolution.Search(problem)))
    assert len(generations) == 3
    assert np.array_equal(trainer.controller.flat, shared.flat) == (updates == 0)
    last = generations[-1]
    bodies = [eldir.develop(LATTICE, walker.genotype) for walker in last]
    walked = example["training"].walks(trainer.controller, bodies)
    np.testing.assert_allclose([walker.fitness for walker in last], walked, rtol=1e-6)


@pytest.mark.slow
def test_the_study_runs_and_goes_on_with_missing_seeds(
    example, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main, load = example["study"].main, example["training"].load
    main(["--small", "--out", str(tmp_path), "--seeds", "1"])
    assert "unseen bodies, pretrained weights" in capsys.readouterr().out
    written = (tmp_path / "seed-1.json").read_text()
    found = json.loads(written)
    assert set(found["evolution"]) == {"paper", "zero-shot", "few-shot", "from scratch", "zero-shot, small"}
    assert found["unseen"]["pretrained"]["mean"] == sorted(found["unseen"]["pretrained"]["mean"])
    assert load(tmp_path / "controller-1.npz").flat.std() > 0
    main(["--small", "--out", str(tmp_path), "--seeds", "1", "2"])
    assert (tmp_path / "seed-1.json").read_text() == written
    assert (tmp_path / "seed-2.json").read_text() != written


@pytest.mark.parametrize("wrong", [["--seeds", "-1"], ["--out", __file__]], ids=["seed", "folder"])
def test_wrong_arguments_of_the_study_are_one_line(
    example, tmp_path: Path, wrong: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        example["study"].main(["--small", "--out", str(tmp_path / "new"), *wrong])
    assert end.value.code == 2
    assert "expected" in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "new").exists()


def test_results_of_another_size_are_not_taken_for_those_of_the_study(
    example, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "seed-1.json").write_text(json.dumps({"size": {"rows": 3}}))
    with pytest.raises(SystemExit):
        example["study"].main(["--out", str(tmp_path), "--seeds", "1"])
    assert "of another size: take another folder" in capsys.readouterr().err
