"""The device's kernels as NVIDIA's assembler makes them: no spills, and two blocks on a multiprocessor."""

from __future__ import annotations

import inspect
import re
import shutil
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest

from benchmarks import assembly, limits
from eldir.core.kernels import compiler_name
from eldir.engine.device import forward, reverse, update
from tests.eldir.engine.device.nvidia_tools import require_tool

pytestmark = [
    pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler named cc"),
    pytest.mark.slow,
]


@pytest.fixture(
    scope="module", params=[128, *(pytest.param(n, marks=pytest.mark.stress) for n in (64, 192, 256))]
)
def launches(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> list[assembly.Launch]:
    """The kernels in their order, for blocks of so many threads."""
    require_tool("ptxas")
    return limits.launch_kernels(compiler_name(), tmp_path_factory.mktemp("stub"), request.param)


@cache
def assembled(*launches: assembly.Launch, architecture: int) -> list[assembly.AssembledKernel]:
    return assembly.assemble(launches, architecture)


@pytest.mark.compiler
@pytest.mark.parametrize("architecture", assembly.ARCHITECTURES)
def test_no_spills_and_two_blocks_or_more(launches: list[assembly.Launch], architecture: int) -> None:
    kernels = assembled(*launches, architecture=architecture)
    told = "\n".join(assembly.table(kernels))
    transpose, forward, reverse, update = kernels
    threads = launches[0].threads
    # The compilers ask for two blocks on a multiprocessor: 255 registers to 128 threads, 168 to 192.
    few = 0 if compiler_name() == "quadrants" else 16  # Taichi's passes take all of the 255
    max_spills = {128: few, 64: 16}.get(threads, 500)
    assert all(k.stack <= max_spills and k.spill_stores <= max_spills for k in kernels), told
    assert all(k.threads == threads and k.blocks >= 2 for k in kernels), told
    assert transpose.registers <= 64 and transpose.barriers <= 1 == forward.barriers == reverse.barriers, told
    # Numbers of each thread: 18 in both passes (state, gradients, forces, activations, inputs), then one.
    assert all(18 * 4 * threads < k.shared < 18 * 4 * threads + 512 for k in (forward, reverse)), told
    assert 4 * threads < update.shared < 4 * threads + 128, told


def phases_of(module: ModuleType, kernel: str) -> int:
    """Number of phases in the source."""
    (body,) = re.findall(rf"\ndef {kernel}\(thread, .*?(?:\n\n|$)", inspect.getsource(module), re.DOTALL)
    return body.count("phase(")


@pytest.mark.compiler
def test_each_phase_has_one_barrier(launches: list[assembly.Launch]) -> None:
    """Compilers may copy a barrier into two branches, and then threads of one warp wait at different ones for
    ever: so it went on an H100, where LLVM had split a critical edge of the flow."""
    sources = {"transpose": update, "forward": forward, "reverse": reverse, "update": update}
    phases = {kernel: phases_of(module, kernel) for kernel, module in sources.items()}
    assert phases["transpose"] == 1 and min(phases["forward"], phases["reverse"], phases["update"]) >= 5
    code = [one.file.read_text() for one in launches]
    assert [text.count("bar.sync") for text in code] == [*phases.values()]
    assert not any("critedge" in text for text in code)


@pytest.mark.stress
def test_with_friction_too(tmp_path: Path) -> None:
    test_each_phase_has_one_barrier(limits.launch_kernels(compiler_name(), tmp_path, 128, True))


def test_limits_of_an_h100(launches: list[assembly.Launch]) -> None:
    """Calculated: from a tenth to five times what is expected of a GPU, 20 000 to 70 000 robots a second."""
    require_tool("nvdisasm")
    kernels = assembled(*launches, architecture=limits.H100.architecture)
    work = limits.works(**limits.MEAN_ROBOT, steps=1000)
    # 37 000 operations of a step forward and 67 000 back, 28 000 of them for the gradients of 14 000 weights.
    total = work[1].operations + work[2].operations + work[3].operations / 1000
    assert total == pytest.approx(104e3, rel=0.1) and work[0].loads == pytest.approx(14e3, rel=0.05)
    times = [limits.seconds(kernel, one) for kernel, one in zip(kernels, work, strict=True)]
    rates = {name: 1 / sum(each[name] for each in times) for name in limits.LIMITS}
    assert rates["arithmetic"] == pytest.approx(640e3, rel=0.1)
    assert all(10e3 < rate < 1e6 for rate in rates.values()), rates
    assert rates["occupancy, L2"] < rates["occupancy, L1"] < rates["arithmetic"]
