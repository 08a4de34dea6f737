"""The device's kernels as NVIDIA's assembler makes them: no spills, and two blocks on a multiprocessor."""

from __future__ import annotations

import shutil

import pytest

from benchmarks import assembly
from eldir.core.kernels import compiler_name
from eldir.errors import MissingDependencyError

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler named cc")


@pytest.fixture(
    scope="module", params=[128, *(pytest.param(n, marks=pytest.mark.stress) for n in (64, 192, 256))]
)
def launches(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> list[assembly.Launch]:
    """The kernels in their order, for blocks of so many threads."""
    try:
        assembly.find_tool("ptxas")
    except MissingDependencyError as error:
        pytest.skip(str(error))
    made = assembly.launch_on_stub(
        "tests.eldir.engine.device.device_learning:launch", request.param,
        compiler=compiler_name(), folder=tmp_path_factory.mktemp("stub"),
    )  # fmt: skip
    return [one for one in made if one.kernel.startswith("launch_") and one.kernel.endswith("range_for")]


@pytest.mark.parametrize("architecture", assembly.ARCHITECTURES)
def test_no_spills_and_two_blocks_or_more(launches: list[assembly.Launch], architecture: int) -> None:
    kernels = assembly.assemble(launches, architecture)
    told = "\n".join(assembly.table(kernels))
    transpose, forward, reverse, update = kernels
    threads = launches[0].threads
    assert all(k.stack == k.spill_stores == k.spill_loads == 0 for k in kernels), told
    assert all(k.threads == threads and k.blocks >= 2 for k in kernels), told
    assert transpose.registers <= 64 and transpose.barriers <= 1 == forward.barriers == reverse.barriers, told
    # Numbers of each thread: 18 in the forward pass (state, forces, activations, inputs), 28 in reverse.
    assert 18 * 4 * threads < forward.shared < 20 * 4 * threads + 1024, told
    assert 28 * 4 * threads < reverse.shared < 30 * 4 * threads + 1024 and update.shared < 8 * threads, told
