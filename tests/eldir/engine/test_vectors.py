"""How vectors are read from memory."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.compiler

PROGRAM = """
import sys

import numpy as np
from eldir.engine.compiler import aligned, ti
from eldir.engine.kernels.memory import Column, Memory
from eldir.engine.kernels.simd import vectors

ti.init(
    arch=ti.cpu, log_level=ti.ERROR, offline_cache=False, real_matrix_scalarize=False, opt_level=0,
    advanced_optimization=False, make_cpu_multithreading_loop=False, print_kernel_llvm_ir_optimized=True,
)
simd = vectors("f32")
ones, by_16 = (ti.types.ndarray(dtype=ti.types.vector(n, ti.f32), ndim=1) for n in (1, 16))
values = ti.types.ndarray(dtype=ti.f32, ndim=1)

@ti.kernel
def copy_singly(x: values, rows: ti.i32, ahead: ti.i32, out: by_16):
    for _ in range(1):
        for i in range(rows):
            column = ti.static(Column(Memory(values=x), 0))
            out[i] = simd.lanes([column.each[16 * i + ahead + j] for j in ti.static(range(16))])

@ti.kernel
def copy(x: ones, rows: ti.i32, ahead: ti.i32, out: by_16):
    for _ in range(1):
        for i in range(rows):
            out[i] = simd.shifted(ti.static(Column(Memory(ones=x), 0)), i, ahead)

x, out = np.arange(80, dtype=np.float32), aligned(64, np.float32)
if sys.argv[1] == "together":
    copy(x.reshape(-1, 1), 4, 3, out.reshape(-1, 16))
else:
    copy_singly(x, 4, 3, out.reshape(-1, 16))
assert np.array_equal(out, x[3:67]), out
"""


def _indices_of_each_vector(how: str, folder: Path) -> float:
    """Indices that the compiled program computes for each 16 values that it stores, whether its loop is
    unrolled or not: how often, each compiler decides for each processor."""
    (folder / "program.py").write_text(PROGRAM)  # the compilers read a kernel's source in its file
    subprocess.run([sys.executable, "program.py", how], cwd=folder, check=True)
    (code,) = (path.read_text() for path in folder.glob("*llvm_ir_optimized*.ll"))
    loops = "".join(part for part in code.split("\n\n") if "store <16 x float>" in part)
    indices = re.findall(r"= sext (?:i32|<(\d+) x i32>)", loops)
    return sum(int(lanes or 1) for lanes in indices) / loops.count("store <16 x float>")


def test_sixteen_values_from_any_address_have_one_index(tmp_path: Path) -> None:
    """With an index for each, the values would be loaded one after the other: learning then takes a sixth
    longer, and everything else is as it should be."""
    assert 0 < _indices_of_each_vector("together", tmp_path) <= 4


def test_values_that_are_named_singly_have_sixteen(tmp_path: Path) -> None:
    """What the test above must be able to see, on this processor."""
    assert _indices_of_each_vector("singly", tmp_path) >= 16
