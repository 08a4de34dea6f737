"""tanh as the controller computes it."""

import numpy as np
import pytest

from eldir.engine.compiler import aligned
from eldir.engine.kernels.controller import tanh_rows
from eldir.engine.kernels.memory import Column, Memory
from eldir.engine.kernels.simd import vectors
from eldir.engine.runtime import start


@pytest.mark.compiler
@pytest.mark.parametrize(("precision", "error"), [("f32", 3e-7), ("f64", 2e-15)])
def test_tanh_is_right_everywhere(precision: str, error: float) -> None:
    ti = start()
    simd = vectors(precision)

    @ti.kernel
    def compute(x: ti.types.ndarray(dtype=simd.row, ndim=1), blocks: ti.i32):
        for _ in range(1):
            tanh_rows(simd, ti.static(Column(Memory(rows=x), 0)), blocks)

    values = np.concatenate([np.linspace(-30, 30, 6000), np.geomspace(1e-12, 1, 399), [0.0]])
    x = aligned(len(values), np.float32 if precision == "f32" else np.float64)
    x[:] = values
    wanted = np.tanh(x.astype(np.float64))
    compute(x.reshape(-1, 32), len(values) // 32)
    errors = np.abs(x - wanted)
    assert errors.max() < error and x[-1] == 0
    near = np.abs(wanted) < 1e-3
    assert (errors[near][:-1] <= 4 * error * np.abs(wanted[near][:-1])).all()
