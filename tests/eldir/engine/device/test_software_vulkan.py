"""Software devices run blocks with shared memory and barriers, write results, and learn as the CPU does."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from benchmarks.assembly import call
from eldir.controller import Controller
from eldir.core.kernels import compiler_name
from eldir.core.records import FloatArray
from eldir.engine.batch import BatchConfig, run_batch
from eldir.engine.device import process
from eldir.errors import EldirError
from eldir.lattice import Lattice
from tests.eldir.engine.device.device_learning import LENGTH, PAPER, make_task, some_scene
from tests.eldir.engine.device.software_vulkan import use_driver
from tests.eldir.engine.random_robots import WEIGHTS, robots

ROOM = "tests.eldir.engine.device"
SEED = 1


def on_device(driver: str, folder: Path, function: str, *arguments: object) -> list:
    environment = use_driver(driver, folder)
    place = f"{ROOM}.{function}"
    return call(place, *arguments, arch="vulkan", compiler=compiler_name(), environment=environment)


@pytest.mark.compiler
@pytest.mark.parametrize(
    ("driver", "precision", "rounds"),
    [
        ("lavapipe", "f64", 500),
        pytest.param("swiftshader", "f32", 10, marks=pytest.mark.stress),
    ],
)
def test_sums_of_blocks_are_exact(driver: str, precision: str, rounds: int, tmp_path: Path) -> None:
    sums = on_device(driver, tmp_path, "small_kernels:add_up", precision, rounds)
    part = 64 * rounds
    assert sums == [part * k * part + part * (part - 1) / 2 for k in range(4)]


def test_a_device_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    """The compilers would go on with the processor."""
    environment = use_driver("lavapipe", tmp_path)
    nothing = {name: str(tmp_path / "nothing.json") for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES")}
    with pytest.raises(EldirError, match=r"(x64|arm64) started instead of vulkan"):
        call(
            f"{ROOM}.small_kernels:add_up", "f64", 1,
            arch="vulkan", compiler=compiler_name(), environment=environment | nothing,
        )  # fmt: skip


def of_robots(best: FloatArray, at: FloatArray) -> list[FloatArray]:
    """Weights or gradients of each robot."""
    return [np.asarray(best[at[k] : at[k + 1]], np.float64) for k in range(len(at) - 1)]


def distance(a: FloatArray, b: FloatArray) -> float:
    """Relative to the length of b."""
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


@pytest.fixture
def vulkan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Robots learn in a worker process on Vulkan, without a GPU."""
    for name, value in use_driver("lavapipe", tmp_path).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("ELDIR_DEVICE", "vulkan")
    yield
    process.device_workers("vulkan").stop([0])
    process.device_workers.cache_clear()


@pytest.mark.slow
def test_a_worker_learns_on_a_device_as_this_process_on_the_processor(
    vulkan: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Robots of several sizes: loss and gradients, twice by the same worker; then two updates in launches of
    10 steps or fewer. Lavapipe allows few steps."""
    scene = some_scene("f64", 25)
    batch = robots(Lattice(5, 9), 3, SEED, scene)
    task = make_task(*batch, scene, 2, 10)
    found = [run_batch(*batch, scene, config=BatchConfig(backward=True)) for _ in range(2)]
    assert found[0].losses.tobytes() == found[1].losses.tobytes()
    assert found[0].best.tobytes() == found[1].best.tobytes()
    trained = process.compute(task)
    monkeypatch.setenv("ELDIR_DEVICE", "cpu")
    for there, iterations in ((found[0], 0), (trained, 2)):
        wanted = run_batch(
            *batch, scene, config=BatchConfig(backward=True, iterations=iterations, update_length=LENGTH)
        )
        assert there.status.tolist() == wanted.status.tolist() == [-1] * 3
        np.testing.assert_allclose(there.losses, wanted.losses, rtol=0, atol=1e-12)
        at = wanted.batch.weight_at
        pairs = zip(of_robots(there.best, at), of_robots(wanted.best, at), strict=True)
        assert max(distance(a, b) for a, b in pairs) < 1e-9


@pytest.mark.stress
def test_learning_in_float32_rounds_as_the_cpu_does(tmp_path: Path) -> None:
    """Over 1000 steps a robot amplifies roundings by a factor of its own. Eight runs on the CPU in float32,
    of weights that differ by roundings, show it against float64. One error in a hundred is far larger."""
    count, steps = 32, 1000
    bodies, brains = robots(Lattice(*PAPER), count, SEED, some_scene("f64", steps))
    losses, status, best = on_device(
        "swiftshader", tmp_path, "device_learning:learn", "f32", steps, count, 0, steps, SEED, PAPER
    )
    assert status == [-1] * count
    exact = run_batch(bodies, brains, some_scene("f64", steps), config=BatchConfig(backward=True))
    at = exact.batch.weight_at
    slopes = of_robots(exact.best, at)

    def errors(losses: FloatArray, best: FloatArray) -> FloatArray:
        """Of losses and of gradients, shape (2, robots)."""
        off = [distance(a, b) for a, b in zip(of_robots(best, at), slopes, strict=True)]
        return np.array([np.abs(losses.ravel() - exact.losses.ravel()), off])

    rng = np.random.default_rng(SEED)
    own = []
    for k in range(8):
        near = [rounded(brain, rng) if k else brain for brain in brains]
        result = run_batch(bodies, near, some_scene("f32", steps), config=BatchConfig(backward=True))
        own.append(errors(result.losses, result.best))
    device = errors(np.array(losses), np.array(best))
    assert (device > 3 * np.max(own, axis=0)).sum() <= 1
    assert (np.median(device / np.median(own, axis=0), axis=1) < 2).all()


def rounded(brain: Controller, rng: np.random.Generator) -> Controller:
    """Weights that differ by half a unit in the last place of float32."""
    weights = (getattr(brain, name) for name in WEIGHTS)
    return Controller(*(w * (1 + 6e-8 * rng.standard_normal(w.shape)) for w in weights))
