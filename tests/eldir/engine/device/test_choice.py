"""Where robots learn: what is asked for and refused, and what a run file says of it."""

from __future__ import annotations

import logging
import shutil
from pathlib import Path
from typing import Any

import pytest

from benchmarks.assembly import compile_stub
from eldir.engine.batch import BatchConfig, run_batch
from eldir.engine.device import process
from eldir.engine.device.process import chosen_device, cuda_devices, learns_on_device
from eldir.engine.shortcuts import Shortcuts
from eldir.errors import InputError, MissingDependencyError
from eldir.evolution import EvolutionConfig, resume
from eldir.evolution.paper.run_folder import RunFile, RunFolder
from eldir.lattice import Lattice
from eldir.scene import Scene
from tests.eldir.engine.random_robots import robots
from tests.raised import raises

PAPER = Scene.preset("paper").replace(steps=20, precision="f64")
WITHOUT_GPU = pytest.mark.skipif(cuda_devices() > 0, reason="there is a CUDA device here")


def test_other_names_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ELDIR_DEVICE", "gpu")
    with raises(InputError, "input.wrong-value", "ELDIR_DEVICE"):
        chosen_device()


@pytest.mark.parametrize(
    ("how", "word"),
    [
        ({"physics_gradients": True}, "gradients of physics"),
        ({"record": True}, "states"),
        ({"shortcuts": Shortcuts(stop=False)}, "shortcuts"),
    ],
)
def test_what_no_device_computes_is_refused(
    how: dict[str, Any], word: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ELDIR_DEVICE", "cuda")
    with raises(InputError, "device.not-yet", match=f"cuda does not compute .*{word}.* yet"):
        run_batch(*robots(Lattice(4, 7), 1, 0, PAPER), PAPER, config=BatchConfig(backward=True, **how))


def test_auto_computes_it_on_the_processor_and_says_so_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("ELDIR_DEVICE", "auto")
    monkeypatch.setattr(process, "cuda_devices", lambda: 1)
    process.warn_once.cache_clear()
    assert learns_on_device()
    for _ in range(2):
        assert not learns_on_device(other_gradients=True)
    assert [r.levelno for r in caplog.records] == [logging.WARNING]
    assert "gradients of physics yet: the processor does" in caplog.text


@WITHOUT_GPU
def test_without_a_gpu_cuda_is_refused_and_auto_learns_on_the_processor(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("ELDIR_DEVICE", "cuda")
    batch = robots(Lattice(4, 7), 1, 0, PAPER)
    with raises(MissingDependencyError, "device.missing", match="no CUDA device"):
        run_batch(*batch, PAPER, config=BatchConfig(backward=True))
    monkeypatch.setenv("ELDIR_DEVICE", "auto")
    assert chosen_device() == "cpu"
    assert run_batch(*batch, PAPER, config=BatchConfig(backward=True)).status.tolist() == [-1]


def test_the_run_file_says_where_robots_learn_and_resuming_elsewhere_warns(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    config = EvolutionConfig(Lattice(4, 7), population=2, generations=0, iterations=1, scene=PAPER)
    monkeypatch.setenv("ELDIR_DEVICE", "vulkan")
    assert RunFile.load(RunFolder.create(tmp_path / "run", config).path / "run.json").device == "vulkan"
    monkeypatch.setenv("ELDIR_DEVICE", "cpu")
    assert resume(tmp_path / "run").device == "vulkan"
    assert "began to learn on vulkan and continues on cpu" in caplog.text


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler named cc")
def test_drivers_are_asked_for_their_devices(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The stub driver has one device, and says so."""
    import ctypes

    compile_stub(tmp_path)
    monkeypatch.setattr(process, "cuda_driver", lambda: ctypes.CDLL(str(tmp_path / "libcuda.so")))
    assert cuda_devices.__wrapped__() == 1
