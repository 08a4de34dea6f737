"""Starting the engine, and what its shortcuts must not change."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eldir.core.kernels import compiler_name
from eldir.core.records import FloatArray
from eldir.engine import batch
from eldir.engine.ground import pack_ground
from eldir.engine.kernels.contact import SEGMENT_VALUES
from eldir.engine.pack import ORIGIN
from eldir.errors import InputError
from eldir.lattice import Lattice
from eldir.learning import initial_controllers, learn
from eldir.rollout import loss_and_gradient, simulate
from eldir.scene import Scene
from eldir.terrain import Terrain
from tests.eldir.engine.random_robots import SMALL, WEIGHTS, learned_numbers, one, robots, triangles_at
from tests.eldir.engine.twin import paper_rollout
from tests.raised import raises


def python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=os.environ, timeout=300
    )


@pytest.mark.compiler
def test_import_starts_nothing_and_threads_may_start_and_use_it_at_the_same_time_without_a_word() -> None:
    ran = python(
        "import eldir.engine, eldir.engine.batch; from eldir.engine.compiler import ti\n"
        "def started():\n"
        "    runtime = ti.lang.impl.get_runtime()\n"
        "    return vars(runtime).get('_prog', vars(runtime).get('prog')) is not None\n"  # Taichi's name
        "assert not started()\n"
        "from concurrent.futures import ThreadPoolExecutor\n"
        "from eldir.rollout import loss_and_gradient; from eldir.scene import Scene\n"
        "from tests.eldir.engine.random_robots import SMALL, robots\n"
        "scene = Scene.preset('paper').replace(steps=3)\n"
        "bodies, brains = robots(SMALL, 12, 1, scene)\n"
        "parts = [slice(i, i + 3) for i in range(0, 12, 3)]\n"
        "assert not started()\n"
        "with ThreadPoolExecutor(4) as pool:\n"
        "    found = list(pool.map(lambda p: loss_and_gradient(bodies[p], brains[p], scene)[0], parts))\n"
        "assert started()\n"
        "assert [x for part in found for x in part] == list(loss_and_gradient(bodies, brains, scene)[0])"
    )
    assert ran.stdout + ran.stderr == ""


def test_importing_the_engine_loads_no_compiler() -> None:
    ran = python(
        "import sys, eldir.engine.stable_step, eldir.engine.shortcuts\n"
        "assert not {'taichi', 'quadrants'} & set(sys.modules)"
    )
    assert ran.stdout + ran.stderr == ""


COMPILED = """
import sys
from eldir.engine.kernels import simd

otherwise, wide = sys.argv[1], simd.has_wide_registers()
if otherwise == "registers":
    simd.has_wide_registers = lambda: not wide
from eldir.engine import batch
from eldir.engine.compiler import ti
if otherwise == "algebra":
    set_compile_options = batch.set_compile_options

    def without(precision):
        set_compile_options(precision)
        assert ti.cfg.advanced_optimization
        ti.cfg.advanced_optimization = False

    batch.set_compile_options = without
from tests.eldir.engine.random_robots import learned_numbers

print(*learned_numbers())
"""


def compiled(otherwise: str) -> FloatArray:
    """The numbers of `learned_numbers`, with something compiled otherwise."""
    ran = subprocess.run(
        [sys.executable, "-c", COMPILED, otherwise], capture_output=True, text=True, check=True, timeout=300
    )
    return np.array(ran.stdout.split(), dtype=np.float64)


@pytest.fixture(scope="module")
def as_it_is() -> FloatArray:
    return learned_numbers()


@pytest.mark.compiler
def test_processors_with_other_registers_compute_the_same(as_it_is: FloatArray) -> None:
    """What is compiled for processors of the other kind, on this one."""
    found, largest = compiled("registers"), np.abs(as_it_is).max()
    assert len(as_it_is) > 1000 and largest > 0
    assert not np.array_equal(found, as_it_is), "sums of another order round differently"
    np.testing.assert_allclose(found, as_it_is, rtol=1e-8, atol=1e-12 * largest)


@pytest.mark.compiler
@pytest.mark.skipif(compiler_name() != "taichi", reason="Quadrants' algebra rounds differently")
def test_the_compilers_algebra_changes_no_byte_of_float64(as_it_is: FloatArray) -> None:
    assert compiled("algebra").tobytes() == as_it_is.tobytes()


@pytest.mark.compiler
def test_without_vectors_it_goes_on_and_says_so_once() -> None:
    ran = python(
        "import logging\n"
        "from eldir.engine import runtime\n"
        "from eldir.engine.kernels import simd\n"
        "logging.basicConfig()\n"
        "runtime.initialise(vectors=True)\n"
        "check = simd.vectors_work\n"
        "assert check()\n"
        "simd.vectors_work = lambda: False\n"
        "ti = runtime.start()\n"
        "runtime.start()\n"
        "assert check()  # the same results, more slowly\n"
        "print(ti.lang.impl.current_cfg().real_matrix_scalarize)"
    )
    assert ran.stdout.strip().endswith("True")
    assert ran.stderr.count("vector code does not work") == 1


@pytest.mark.parametrize("terrain", [Terrain.flat(), Terrain.rugged(np.random.default_rng(1))])
def test_a_rollout_shows_the_bits_that_were_learned(terrain: Terrain) -> None:
    scene = Scene.preset("paper").replace(terrain=terrain, steps=400)
    bodies, brains = robots(SMALL, 8, 11, scene)
    learned = learn(bodies, scene, 3, controllers=brains)
    shown = [r.loss for r in simulate(bodies, learned.controllers, scene)]
    assert shown == learned.losses.min(axis=1).tolist()
    assert loss_and_gradient(bodies, learned.controllers, scene)[0].tolist() == shown


@pytest.mark.parametrize("terrain", [Terrain.flat(), Terrain.rugged(np.random.default_rng(1))])
def test_nothing_is_read_that_was_not_written(terrain: Terrain, monkeypatch: pytest.MonkeyPatch) -> None:
    """A workspace full of what another robot left changes no bit."""
    scene = Scene.preset("paper").replace(terrain=terrain, steps=70)
    large, small = robots(Lattice(), 1, 2, scene), robots(SMALL, 6, 2, scene)
    bodies, brains = large[0] + small[0], large[1] + small[1]
    clean = learn(bodies, scene, 2, controllers=brains)
    zeros = batch.aligned

    def used(size: int, dtype: object) -> np.ndarray:
        memory = zeros(size, dtype)
        if size > 1_000_000:
            memory[:] = 7.0
        return memory

    monkeypatch.setattr(batch, "aligned", used)
    dirty = learn(bodies, scene, 2, controllers=brains)
    assert dirty.losses.tobytes() == clean.losses.tobytes()
    for a, b in zip(dirty.controllers, clean.controllers, strict=True):
        assert all(np.array_equal(getattr(a, k), getattr(b, k)) for k in WEIGHTS)


def test_more_steps_than_can_be_counted_are_refused() -> None:
    scene = Scene.preset("paper").replace(steps=10_000_000)
    with raises(InputError, "scene.too-many-steps"):
        loss_and_gradient(*robots(SMALL, 1, 1, scene), scene)


def test_ground_cut_into_many_segments_is_the_same_ground() -> None:
    x0 = np.concatenate([[-1.0], np.sort(np.random.default_rng(3).uniform(-0.5, 1.0, 200))])
    slope = np.full(201, 0.1)
    whole = Terrain.from_segments(np.array([0.0]), slope[:1], np.array([0.1]))
    cut = Terrain.from_segments(x0, slope, np.full(201, 0.1))
    scene = Scene.preset("paper").replace(terrain=whole, precision="f64", steps=150)
    bodies, brains = robots(SMALL, 3, 5, scene)
    for a, b in zip(
        simulate(bodies, brains, scene), simulate(bodies, brains, scene.replace(terrain=cut)), strict=True
    ):
        assert np.abs(a.positions - b.positions).max() < 1e-10


@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(["friction", "friction-released"]))
@settings(max_examples=60, deadline=None)
def test_the_grid_never_hides_ground(seed: int, kind: str) -> None:
    rng = np.random.default_rng(seed)
    terrain = Terrain.rugged(rng, float(rng.choice([-0.2, 0.0, 0.2])))
    scene = Scene.preset("paper").replace(
        terrain=terrain, contact=kind, precision=str(rng.choice(["f32", "f64"]))
    )
    ground, (origin, _) = pack_ground(scene, grid=True), ORIGIN
    cells = len(ground.cell_segment)
    edges = np.concatenate([terrain.x0, np.arange(cells) / ground.cells_per_m + ground.grid_start + origin])
    x = np.concatenate([rng.uniform(-2, 3, 200), edges, np.nextafter(edges, 9), np.nextafter(edges, -9)])
    cell = np.clip(np.floor((x - origin - ground.grid_start) * ground.cells_per_m) + 1, 0, cells - 1)
    starts = ground.segments.reshape(-1, SEGMENT_VALUES)[:, 0] + origin
    first = ground.cell_segment[cell.astype(int)]
    assert (starts[first] <= x).all()
    assert (np.searchsorted(starts, x, side="right") - 1 <= first + 2).all(), "it begins just before"


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=12, deadline=None)
def test_twin_agrees_on_any_body_and_ground(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shapes = [triangles_at((0, 1)), triangles_at((0, 1), (1, 1)), triangles_at((0, 1), (0, 2), (1, 2))]
    body = (
        one(shapes[rng.integers(3)], seed=seed)
        if rng.random() < 0.4
        else robots(SMALL, 1, seed, Scene.preset("paper"))[0][0]
    )
    scene = Scene.preset(str(rng.choice(["paper", "released-rss", "released-main"])))
    if rng.random() < 0.6:
        scene = scene.replace(terrain=Terrain.rugged(rng, float(rng.choice([-0.2, 0.0, 0.2]))))
    scene = scene.replace(precision="f64", steps=25)
    (brain,) = initial_controllers([body], scene, seed)
    rollout = simulate([body], [brain], scene)[0]
    x, v, a = paper_rollout(body, brain, scene)
    assert np.abs(rollout.positions - x).max() < 1e-10
    assert np.abs(rollout.velocities - v).max() < 1e-8
    assert np.abs(rollout.activations - a).max() < 1e-9
