"""What NVIDIA's assembler makes of kernels, on a machine without a GPU."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from benchmarks import assembly, limits, machine_code
from benchmarks.machine_code import Instruction
from eldir.core.kernels import compiler_name
from eldir.errors import EldirError
from tests.eldir.engine.device.nvidia_tools import require_tool

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler named cc")
KERNELS = "tests.eldir.engine.device.small_kernels"


@pytest.fixture(scope="module")
def launches(tmp_path_factory: pytest.TempPathFactory) -> dict[str, assembly.Launch]:
    require_tool("ptxas")
    folder = tmp_path_factory.mktemp("stub")
    made = assembly.launch_on_stub(f"{KERNELS}:launch", compiler=compiler_name(), folder=folder)
    return {name: one for name in ("share", "keep", "walk") for one in made if one.kernel.startswith(name)}


def test_each_kernel_comes_once_with_its_blocks_of_threads(launches: dict[str, assembly.Launch]) -> None:
    assert [(one.threads, one.shared) for one in launches.values()] == [(64, 0), (128, 0), (64, 0)]


@pytest.mark.parametrize("architecture", assembly.ARCHITECTURES)
def test_registers_and_shared_memory_are_told(
    launches: dict[str, assembly.Launch], architecture: int
) -> None:
    share, keep, walk = assembly.assemble([*launches.values()], architecture)
    assert (share.shared, share.spill_stores, share.stack) == (256 * 4, 0, 0)
    assert walk.shared == 64 * 4
    assert (keep.shared, keep.spill_stores, keep.spill_loads) == (0, 0, 0)
    assert 48 < keep.registers < 128 and share.registers < 32
    assert share.blocks == assembly.ARCHITECTURES[architecture].blocks and keep.blocks < 10
    assert share.file.stat().st_size > 1000


def test_spills_are_told(launches: dict[str, assembly.Launch]) -> None:
    (keep,) = assembly.assemble([launches["keep"]], 90, max_registers=32)
    assert keep.registers == 32 and min(keep.spill_stores, keep.spill_loads, keep.stack) >= 4 * (48 - 32)


def test_a_function_that_fails_is_told_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(EldirError, match=r"is_not_there ended with an error.*has no attribute") as told:
        assembly.launch_on_stub(f"{KERNELS}:is_not_there", compiler=compiler_name(), folder=tmp_path)
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


@pytest.fixture(scope="module")
def walk(launches: dict[str, assembly.Launch]) -> assembly.AssembledKernel:
    require_tool("nvdisasm")
    (kernel,) = assembly.assemble([launches["walk"]], 90)
    return kernel


def test_a_step_is_the_loop_with_barriers(walk: assembly.AssembledKernel) -> None:
    every = machine_code.read_loops(walk)
    (step,) = machine_code.step_loops(every)
    inner = [*step.walk()][1:]
    assert step.barriers == 2 and step.count("STS") == 1
    assert inner and all(0 < loop.numbers == loop.count("FFMA") for loop in [step, *inner])
    counted = sum(len(loop.own) for loop in every.walk())
    assert counted == every.last + 1 > 2 * len(step.own)
    text = "\n".join(machine_code.describe_loops(walk))
    assert f"{step.first}-{step.last}" in text and len(text.splitlines()) == 2 + len([*every.walk()])


def ffma(result: int, *operands: int) -> Instruction:
    return Instruction("FFMA", ", ".join(f"R{n}" for n in (result, *operands)), "")


def test_a_warp_waits_for_results_and_not_for_others() -> None:
    chain = [ffma(1, 1, 2, 3)] * 10
    apart = [ffma(10 + k, 1, 2, 3) for k in range(10)]
    load = [Instruction("LDG.E.64", "R4, desc[UR8][R2.64+0x8]", ""), ffma(6, 5, 1, 1)]
    store = [Instruction("STS", "[R4], R1", ""), ffma(6, 4, 1, 1)]
    assert machine_code.warp_cycles(chain) == 1 + 9 * 4
    assert machine_code.warp_cycles(apart) == 10
    assert machine_code.warp_cycles(load, 40) == 1 + 40  # R5 is the second half of what is loaded
    assert machine_code.warp_cycles(store) == 2


def test_limits_from_counted_numbers(walk: assembly.AssembledKernel) -> None:
    work = limits.Work(steps=1000, operations=67e3, loads=2e4, stores=2e3, memory=3350 / 4)
    times = limits.seconds(walk, work)
    assert times["arithmetic"] == pytest.approx(1e-6) and times["HBM"] == pytest.approx(1e-6)
    assert times["L2"] == pytest.approx(1000 * 22e3 * 4 / 5.5e12)
    # Half of the blocks: a block waits as long as before.
    halved = limits.seconds(walk._replace(blocks=walk.blocks // 2), work)
    changed = {name for name in times if halved[name] != pytest.approx(times[name])}
    assert changed == {"occupancy, L1", "occupancy, L2"}
    assert halved["occupancy, L1"] == pytest.approx(2 * times["occupancy, L1"])
    assert times["occupancy, L1"] < times["occupancy, L2"] < 7 * times["occupancy, L1"]
    # A row is a load, an FFMA and a part of the rest, so twice the rows take nearly twice the instructions.
    more = limits.seconds(walk, work._replace(loads=4e4))
    assert 1.9 < more["instructions"] / times["instructions"] < 2.0
    each = times["instructions"] * 132 * 1.98e9 * 4 / 1000 / (2e4 / 32)
    assert 3 < each < 12, "instructions for each number that a warp loads"
    *_, in_l1, in_l2 = limits.table([(walk, work), (walk, work)])
    slowest = max(time for name, time in times.items() if "L2" not in name)
    value = float(in_l1.split("|")[2].replace(" ", ""))
    assert value == pytest.approx(1 / (2 * slowest), rel=0.05) and "in L2" in in_l2
