"""Evolution from Python: one call makes a run, and an interrupted one goes on to the same bytes."""

import subprocess
import sys

from eldir.errors import EldirError
from eldir.evolution import EvolutionConfig, RunFolder, evolve, load_run, resume
from eldir.evolution.loop import run_generations
from eldir.evolution.workers import LocalWorkers
from eldir.lattice import Lattice
from eldir.scene import Scene
from tests.eldir.evolution.run_folders import contents
from tests.raised import raises

CONFIG = EvolutionConfig(
    Lattice(4, 6), population=6, generations=3, iterations=2, scene=Scene().replace(steps=40), seed=2
)


def test_one_call_makes_a_run_and_reports_each_generation(tmp_path):
    seen = []
    run = evolve(CONFIG, tmp_path / "run", lambda generation, best: seen.append((generation, best)))
    assert [generation for generation, _ in seen] == [0, 1, 2, 3]
    best = load_run(run.path)
    assert seen[-1][1] == best[0].provenance["fitness_m"] >= seen[0][1]
    assert run == RunFolder.open(tmp_path / "run")
    with raises(EldirError, "file.exists"):
        evolve(CONFIG, tmp_path / "run")


def test_an_interrupted_run_is_resumed_to_the_same_bytes(tmp_path):
    whole = evolve(CONFIG, str(tmp_path / "whole"))
    part, seen = RunFolder.create(tmp_path / "part", CONFIG), []
    run_generations(part, part.restore(), LocalWorkers(), iter([False, False, True]).__next__)
    assert 0 < len(part.complete_generations()) < 4
    resume(tmp_path / "part", lambda generation, best: seen.append(generation))
    assert seen[-1] == 3 and len(seen) < 4
    assert {**contents(part.path), "lock": b""} == {**contents(whole.path), "lock": b""}


def test_the_package_loads_nothing_heavy():
    code = "import sys, eldir.evolution; print('numpy' in sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "False"
