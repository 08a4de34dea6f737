"""A launch record arrives in the kernel field by field, whatever its order and nesting."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from eldir.engine.compiler import ti
from eldir.engine.runtime import Constant, Count, Integers, Number, Values, argument_types, make_kernel, start


class Inner(NamedTuple):
    out: Values
    offset: Number


class Outer(NamedTuple):
    scale: Number
    workers: Count
    first: Inner
    factor: Constant
    second: Inner
    index: Integers


@pytest.fixture(scope="module")
def kernel() -> Any:
    start()

    def work(worker, launch: ti.template()):
        k = launch.index[worker]
        launch.first.out[k] = launch.scale * worker + launch.first.offset
        launch.second.out[k] = launch.factor * (launch.scale * worker + launch.second.offset)

    work.__annotations__["launch"] = ti.template()
    return make_kernel(Outer, argument_types(ti.f64), ti.func(work))


@pytest.mark.compiler
@pytest.mark.parametrize("factor", [2, 3])
def test_every_field_arrives_under_its_name(kernel: Any, factor: int) -> None:
    one, two, index = np.zeros(4), np.zeros(4), np.array([3, 1, 0, 2], np.int32)
    kernel(
        Outer(
            index=index, factor=factor, workers=4, scale=10.0, first=Inner(one, 0.5), second=Inner(two, 0.25)
        )
    )
    assert one[index].tolist() == [0.5, 10.5, 20.5, 30.5]
    assert two[index].tolist() == [factor * v for v in (0.25, 10.25, 20.25, 30.25)]


def test_a_record_that_lacks_a_field_is_refused() -> None:
    with pytest.raises(TypeError, match="offset"):
        Inner(np.zeros(1))  # type: ignore[call-arg]
