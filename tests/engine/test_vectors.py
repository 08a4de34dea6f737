"""How vectors are read from memory."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

PROGRAM = """
import numpy as np
from eldir.engine.aligned import aligned
from eldir.engine.compiler import ti
from eldir.engine.kernels.memory import Column, Memory
from eldir.engine.kernels.vectors import vectors

ti.init(
    arch=ti.cpu, log_level=ti.ERROR, offline_cache=False, real_matrix_scalarize=False, opt_level=0,
    advanced_optimization=False, make_cpu_multithreading_loop=False, print_kernel_llvm_ir_optimized=True,
)
kind = vectors("f32")
ones, by_16 = (ti.types.ndarray(dtype=ti.types.vector(n, ti.f32), ndim=1) for n in (1, 16))

@ti.kernel
def copy(x: ones, rows: ti.i32, ahead: ti.i32, out: by_16):
    for _ in range(1):
        for i in range(rows):
            out[i] = kind.shifted(ti.static(Column(Memory(ones=x), 0)), i, ahead)

x, out = np.arange(80, dtype=np.float32), aligned(64, np.float32)
copy(x.reshape(-1, 1), 4, 3, out.reshape(-1, 16))
assert np.array_equal(out, x[3:67]), out
"""


def test_sixteen_values_from_any_address_have_one_index(tmp_path: Path) -> None:
    """With an index for each, the values would be loaded one after the other: learning then takes a sixth
    longer, and everything else is as it should be."""
    (tmp_path / "program.py").write_text(PROGRAM)  # the compilers read a kernel's source in its file
    subprocess.run([sys.executable, "program.py"], cwd=tmp_path, check=True)
    (code,) = (path.read_text() for path in tmp_path.glob("*llvm_ir_optimized*.ll"))
    loop = next(part for part in re.split(r"\n\n", code) if "store <16 x float>" in part)
    indices = re.findall(r"= sext i32|= sext <\d+ x i32>", loop)
    assert 0 < len(indices) <= 4 and not any("<" in index for index in indices), loop
