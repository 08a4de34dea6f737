"""A local Ray cluster of several workers, one of them killed: the same bytes as on one machine."""

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eldir.errors import EldirError
from eldir.evolution.loop import run_generations
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.problem import PaperProblem
from eldir.evolution.paper.run_folder import RunFolder
from eldir.evolution.printed.run_folder import PrintedRun
from eldir.evolution.search import Search
from eldir.evolution.workers import LocalWorkers
from eldir.lattice import Lattice
from eldir.scene import Scene
from tests.eldir.evolution.printed.small_searches import SMALL
from tests.eldir.evolution.run_folders import contents

ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'eldir[cluster]'")
pytestmark = pytest.mark.stress

CONFIG = EvolutionConfig(
    Lattice(6, 11),
    population=72,
    generations=2,
    iterations=12,
    seed=7,
    scene=Scene.preset("paper").replace(steps=400),
)


@pytest.fixture
def cluster(monkeypatch):
    monkeypatch.setenv("ELDIR_THREADS", "1")
    monkeypatch.setenv("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")
    ray.init(num_cpus=3, log_to_driver=False, include_dashboard=False)
    yield
    ray.shutdown()


def workers() -> list[int]:
    """Processes of this test's cluster that learn now."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            told = (folder / "cmdline").read_bytes()
        except OSError:
            continue  # it has just ended
        if told.startswith(b"ray::_run") and os.getpid() in ancestors(int(folder.name)):
            found.append(int(folder.name))
    return found


def ancestors(process: int) -> list[int]:
    found = []
    while process > 1:
        try:
            status = Path(f"/proc/{process}/stat").read_text()
        except OSError:
            break
        process = int(status.rpartition(")")[2].split()[1])
        found.append(process)
    return found


def test_a_worker_is_killed_and_the_run_ends_with_the_same_bytes(tmp_path, cluster):
    from eldir.evolution.cluster import Cluster

    alone = RunFolder.create(tmp_path / "alone", CONFIG)
    run_generations(alone, alone.restore(), LocalWorkers())
    trainer = Cluster()
    assert (
        trainer.processes,
        trainer.threads,
        trainer.part_size(Search(PaperProblem(CONFIG)).ask(), 72),
    ) == (3, 1, 6)
    together = RunFolder.create(tmp_path / "together", CONFIG)
    killed: list[int] = []

    def kill() -> None:
        while len(killed) < 3:
            time.sleep(0.7)
            if learning := [p for p in workers() if p not in killed]:
                os.kill(learning[0], signal.SIGKILL)
                killed.append(learning[0])

    threading.Thread(target=kill, daemon=True).start()
    run_generations(together, together.restore(), trainer)
    assert killed
    assert contents(together.path) == contents(alone.path)


def test_other_code_and_failures_on_a_node_are_told_in_one_line(cluster, monkeypatch):
    from eldir.evolution import cluster as module

    config = replace(CONFIG, scene=CONFIG.scene.replace(dt=1.0))  # no step so large is stable
    shards = list(Search(PaperProblem(config)).ask().parts(np.array([0]), 1))
    with pytest.raises(EldirError, match="step is too large"):
        list(module.Cluster()(shards))
    monkeypatch.setattr(module, "source_digest", lambda: "0123456789ab")
    with pytest.raises(EldirError, match=r"runs other code.*same version"):
        list(module.Cluster()(shards))


def test_the_command_goes_on_with_a_run_of_one_machine(tmp_path):
    def eldir(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "eldir", *arguments],
            check=False,
            capture_output=True,
            text=True,
            env=os.environ | {"ELDIR_THREADS": "1", "RAY_ENABLE_UV_RUN_RUNTIME_ENV": "0"},
        )

    run = str(tmp_path / "run")
    options = [
        "--lattice",
        "4x6",
        "--population",
        "20",
        "--generations",
        "2",
        "--iterations",
        "2",
        "--cluster",
    ]
    done = eldir("evolve", "--out", run, *options)
    assert done.returncode == 0, done.stderr
    assert "3 of 3 generations" in done.stdout
    # Without --cluster the same again.
    other = str(tmp_path / "other")
    assert eldir("evolve", "--out", other, *options[:-1]).returncode == 0
    assert contents(Path(run)) == contents(Path(other))


def test_printed_robots_are_judged_with_the_same_bytes(tmp_path, cluster):
    """Parts of every trial, on three processes."""
    from eldir.evolution.cluster import Cluster

    machines = Cluster()
    for name, workers in (("alone", LocalWorkers()), ("together", machines)):
        run = PrintedRun.create(tmp_path / name, SMALL)
        run_generations(run, run.restore(), workers)
    assert contents(tmp_path / "together") == contents(tmp_path / "alone")


def test_other_code_on_a_node_ends_a_run_of_printed_robots(cluster, monkeypatch, tmp_path):
    from eldir.evolution import cluster as module

    monkeypatch.setattr(module, "source_digest", lambda: "0123456789ab")
    run = PrintedRun.create(tmp_path / "run", SMALL)
    with pytest.raises(EldirError, match=r"runs other code.*same version"):
        run_generations(run, run.restore(), module.Cluster())
