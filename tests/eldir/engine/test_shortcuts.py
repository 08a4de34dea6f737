"""What is left out changes no bit; and what is left out is told."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from eldir.benchmark.skips import CASES, difference
from eldir.engine import batch
from eldir.engine.shortcuts import ALL, Shortcuts, explain_skips
from eldir.lattice import Lattice
from eldir.learning import learn
from eldir.rollout import loss_and_gradient, simulate
from eldir.scene import Scene
from eldir.terrain import Terrain
from eldir_app.application import application
from tests.eldir.engine.random_robots import SMALL, WEIGHTS, like, moved, robots


@pytest.mark.parametrize("name", CASES)
def test_the_long_way_gives_the_same(name: str) -> None:
    bodies, _ = robots(SMALL, 4, 3, Scene())
    found = difference(CASES[name](bodies, Scene().replace(steps=60)))
    assert found.pop("status") == 0
    assert max(found.values()) < 1e-5
    if name not in ROUNDED:
        assert not any(found.values())


ROUNDED = {"no contact in free flight", "no outputs for passive springs", "no search on level ground"}


@pytest.mark.parametrize("backward", [True, False])
def test_the_same_design_is_simulated_once(backward: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene().replace(steps=20)
    bodies, brains = robots(SMALL, 3, 3, scene)
    order = [0, 1, 0, 2, 1, 0]
    many = [bodies[i] for i in order], [brains[i] for i in order]
    simulated = []
    run = batch.run_batch
    monkeypatch.setattr(batch, "run_batch", lambda b, *a, **k: (simulated.append(len(b)), run(b, *a, **k))[1])
    if backward:
        losses, trained = loss_and_gradient(*many, scene)[0], learn(many[0], scene, 2, controllers=many[1])
        assert trained.losses.tobytes() == learn(bodies, scene, 2, controllers=brains).losses[order].tobytes()
    else:
        losses = np.array([r.loss for r in simulate(*many, scene)])
    assert set(simulated) == {3}
    assert losses.tobytes() == np.array([r.loss for r in simulate(bodies, brains, scene)])[order].tobytes()


def test_an_open_loop_has_the_slope_of_its_loss_as_gradient() -> None:
    scene = Scene().replace(sensing="none", precision="f64", steps=40)
    (body,), (brain,) = robots(SMALL, 1, 2, scene)
    _, (gradient,) = loss_and_gradient([body], [brain], scene)
    assert not gradient.w1[:, 10:].any() and gradient.w1[:, :10].any()
    h, rng = 1e-6, np.random.default_rng(0)
    for direction in [like(brain, rng) for _ in range(5)]:
        losses, _ = loss_and_gradient([body] * 2, [moved(brain, direction, s) for s in (-h, h)], scene)
        slope = sum((getattr(gradient, k) * getattr(direction, k)).sum() for k in WEIGHTS)
        assert abs((losses[1] - losses[0]) / (2 * h) - slope) < 1e-6 * max(1, abs(slope))


def test_a_few_states_take_little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    taken = []
    aligned = batch.aligned
    monkeypatch.setattr(batch, "aligned", lambda n, kind: (taken.append(n), aligned(n, kind))[1])
    bodies, brains = robots(SMALL, 1, 3, Scene())
    losses = []
    for shortcuts in (ALL, Shortcuts(no_history=False)):
        taken.clear()
        losses.append(
            batch.run_batch(bodies, brains, Scene(), config=batch.BatchConfig(shortcuts=shortcuts)).losses[
                0, 0
            ]
        )
        losses.append(max(taken))
    assert losses[0] == losses[2] and losses[1] < losses[3] / 5


def test_free_flight_falls_through_the_ground() -> None:
    scene = Scene().replace(contact="none", steps=100)
    bodies, brains = robots(SMALL, 1, 3, scene)
    assert simulate(bodies, brains, scene)[0].positions[-1, :, 1].min() < 0.05


def test_what_was_left_out_is_told() -> None:
    bodies, _ = robots(Lattice(), 2, 1, Scene())
    rugged = Scene().replace(terrain=Terrain.rugged(np.random.default_rng(1)))

    def told(scene: Scene, backward: bool, record: bool) -> str:
        return "\n".join(f"{what}: {why}" for what, why in explain_skips(bodies, scene, backward, record))

    learned = told(Scene(), True, False)
    assert "level" in learned and "springs are passive" in learned and "history" not in learned
    assert "4 states instead of 1000" in told(Scene(), False, False)
    assert "4 states" not in told(Scene(), False, True)
    assert f"among {len(rugged.terrain.x0)} segments" in told(rugged, True, False)
    assert "open loop" in told(Scene().replace(sensing="none"), True, False)
    assert "free flight" in told(Scene().replace(contact="none"), True, False)


def test_evolve_explains_what_it_leaves_out(tmp_path: Path) -> None:
    small = "--lattice 3x5 --population 2 --generations 0 --iterations 1 --explain"
    ran = CliRunner().invoke(
        application("evolve"), ["evolve", "--out", str(tmp_path / "run"), *small.split()]
    )
    assert ran.exit_code == 0, ran.output
    assert "left out: controller outputs: " in ran.stderr and "left out: search for the ground" in ran.stderr
