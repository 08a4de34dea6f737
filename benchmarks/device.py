"""`python -m benchmarks.device --out DIR [--device cuda|vulkan] [--quick]`: a GPU under test, in ten minutes.

Correctness in float64 against the processor, races where NVIDIA's compute-sanitizer is found, speed over
numbers of robots, 10 000 robots with 35 updates, registers and occupancy. One JSON file and a plot.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.assembly import assemble
from benchmarks.limits import launch_kernels
from eldir.core.files import require_new
from eldir.core.kernels import compiler_name
from eldir.core.worker_process import WorkerProcess
from eldir.engine.batch import BatchConfig, BatchResult, run_batch
from eldir.errors import EldirError
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.learning import initial_controllers
from eldir.morphology import develop
from eldir.scene import Scene

_STEPS, _UPDATES, _ROBOTS = 60, 3, 24
_SANITIZER, _TIMEOUT_S = "compute-sanitizer", 60


def learn(precision: str, steps: int, robots: int, updates: int) -> BatchResult:
    """Teach random robots of the paper's lattice, where `ELDIR_DEVICE` says; 0 updates: gradients."""
    scene = Scene.preset("paper").replace(steps=steps, precision=precision)
    bodies = [develop(Lattice(), g) for g in random_genotypes(Lattice(), robots, np.random.default_rng(1))]
    brains = initial_controllers(bodies, scene, 1)
    return run_batch(
        bodies, brains, scene, config=BatchConfig(iterations=updates, backward=True, update_length=0.1)
    )


def correctness() -> dict[str, float]:
    """Largest errors against the processor: of losses [m], and of the gradients and weights of a robot,
    relative."""
    found: dict[str, float] = {}
    for name, updates in (("gradient", 0), ("weights", _UPDATES)):
        arguments = ("f64", _STEPS, _ROBOTS, updates)
        module = import_module("benchmarks.device")  # the worker does not know __main__
        with WorkerProcess(module.__name__, {"ELDIR_DEVICE": "cpu"}) as processor:
            processor.begin(module.learn, *arguments)
            here, there = learn(*arguments), processor.value()
        if not np.array_equal(here.status, there.status):
            raise EldirError("other robots blew up than on the processor", found=f"{here.status}")
        found[f"loss_{name}_m"] = float(np.abs(here.losses - there.losses).max())
        at = there.batch.weight_at
        robots = [slice(at[k], at[k + 1]) for k in range(len(at) - 1)]
        found[name] = max(
            float(np.linalg.norm(here.best[r] - there.best[r]) / np.linalg.norm(there.best[r]))
            for r in robots
        )
    return found


def races() -> dict[str, str]:
    """What NVIDIA's tool says of a small batch: races in shared memory, accesses out of bounds."""
    if shutil.which(_SANITIZER) is None:
        return {tool: f"not looked for: {_SANITIZER} is not installed" for tool in ("racecheck", "memcheck")}
    call = "from benchmarks import device; device.learn_in_this_process()"
    return {
        tool: _last_line([_SANITIZER, "--tool", tool, sys.executable, "-c", call])
        for tool in ("racecheck", "memcheck")
    }


def learn_in_this_process() -> None:
    """A few steps of a few robots, without a worker process: the tool looks at one."""
    from eldir.engine.batch import device_task, pack
    from eldir.engine.device.process import run_task, start_device
    from eldir.physics import resolve_physics

    scene = Scene.preset("paper").replace(steps=6)
    bodies = [develop(Lattice(), g) for g in random_genotypes(Lattice(), 8, np.random.default_rng(1))]
    brains, physics = initial_controllers(bodies, scene, 1), resolve_physics(bodies, scene, None)
    batch = pack(bodies, brains, scene, physics)
    start_device("cuda")
    run_task(device_task(batch, scene, 1, 0.1))


def registers() -> list[dict[str, Any]]:
    """Registers, spills, shared memory and blocks of each kernel, for an H100."""
    with tempfile.TemporaryDirectory() as folder:
        kernels = assemble(launch_kernels(compiler_name(), Path(folder)), 90)
        return [{k: v for k, v in kernel._asdict().items() if k != "file"} for kernel in kernels]


def _last_line(command: Sequence[str]) -> str:
    try:
        ran = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        return f"stopped after {_TIMEOUT_S} s"
    lines = [line for line in ran.stdout.splitlines() if line.startswith("=========")]
    return lines[-1].strip("= ") if lines else f"status {ran.returncode}: {ran.stderr[-200:]}"


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.device", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="new folder for the JSON file and the plot")
    parser.add_argument("--device", default="cuda", choices=("cuda", "vulkan"))
    parser.add_argument("--quick", action="store_true", help="fewer robots")
    options = parser.parse_args(arguments)
    os.environ["ELDIR_DEVICE"] = options.device
    from eldir.benchmark.device import measure, plot
    from eldir.benchmark.measurement import save, say

    try:
        require_new(options.out)
        values: dict[str, Any] = {"correctness": correctness()}
        say(f"errors in float64, {_STEPS} steps: {values['correctness']}")
        values |= measure(options.quick, say)
        if options.device == "cuda":
            values["races"] = races()
            say(f"{values['races']}")
            try:
                values["kernels"] = registers()
            except EldirError as error:
                values["kernels"] = str(error)
        save(options.out, "device", values, plot(values))
    except EldirError as error:
        print(f"benchmarks.device: {error}", file=sys.stderr)
        return 1
    print(f"{options.out}/device.json and {options.out}/device.png")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
