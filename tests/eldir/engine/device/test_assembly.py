"""What NVIDIA's assembler makes of kernels, on a machine without a GPU."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from benchmarks import assembly
from eldir.core.kernels import compiler_name
from eldir.errors import EldirError, MissingDependencyError

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler named cc")
KERNELS = "tests.eldir.engine.device.small_kernels"


@pytest.fixture(scope="module")
def launches(tmp_path_factory: pytest.TempPathFactory) -> dict[str, assembly.Launch]:
    try:
        assembly.find_tool("ptxas")
    except MissingDependencyError as error:
        pytest.skip(str(error))
    folder = tmp_path_factory.mktemp("stub")
    made = assembly.launch_on_stub(f"{KERNELS}:launch", compiler_name(), folder)
    return {name: one for name in ("share", "keep") for one in made if one.kernel.startswith(name)}


def test_each_kernel_comes_once_with_its_blocks_of_threads(launches: dict[str, assembly.Launch]) -> None:
    assert [(one.threads, one.shared) for one in launches.values()] == [(64, 0), (128, 0)]


@pytest.mark.parametrize("architecture", assembly.ARCHITECTURES)
def test_registers_and_shared_memory_are_told(
    launches: dict[str, assembly.Launch], architecture: int
) -> None:
    share, keep = assembly.assemble([*launches.values()], architecture)
    assert (share.shared, share.spill_stores, share.stack) == (256 * 4, 0, 0)
    assert (keep.shared, keep.spill_stores, keep.spill_loads) == (0, 0, 0)
    assert 48 < keep.registers < 128 and share.registers < 32
    assert share.blocks == assembly.ARCHITECTURES[architecture].blocks and keep.blocks < 10
    assert share.file.stat().st_size > 1000


def test_spills_are_told(launches: dict[str, assembly.Launch]) -> None:
    (keep,) = assembly.assemble([launches["keep"]], 90, max_registers=32)
    assert keep.registers == 32 and min(keep.spill_stores, keep.spill_loads, keep.stack) >= 4 * (48 - 32)


def test_a_function_that_launches_nothing_or_fails_is_told_in_one_line(tmp_path: Path) -> None:
    for name in ("launch_none", "launch_what_is_not_there"):
        with pytest.raises(EldirError, match=rf"{name}.*(no kernel|has no attribute)") as told:
            assembly.launch_on_stub(f"{KERNELS}:{name}", compiler_name(), tmp_path)
        assert len(str(told.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("architecture", "threads", "registers", "shared", "blocks"),
    [
        (80, 128, 64, 0, 8),  # 16 warps of 2048 registers in each quarter of 65 536
        (80, 256, 40, 0, 6),  # 12 warps of 1280 registers in a quarter
        (90, 1024, 65, 0, 0),  # 7 warps in a quarter: the block's 32 do not fit
        (90, 1024, 64, 0, 1),
        (90, 64, 16, 0, 32),
        (90, 128, 32, 48 << 10, 4),  # 228 KiB hold four of 49 KiB
        (80, 128, 32, 48 << 10, 3),
        (120, 128, 32, 48 << 10, 2),
        (120, 256, 32, 0, 6),  # 1536 threads
        (90, 100, 255, 0, 2),  # a part of a warp counts as a whole one
    ],
)
def test_blocks_of_a_multiprocessor(
    architecture: int, threads: int, registers: int, shared: int, blocks: int
) -> None:
    assert assembly.blocks_per_multiprocessor(architecture, threads, registers, shared) == blocks
