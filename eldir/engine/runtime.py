"""Starting the compiler once, and kernels that are launched with one record.

A record is a `NamedTuple` whose fields are the arguments of its kernel, declared once for host and kernel.
Each field is annotated with one of the types below, or with another record. The host fills the record with
numbers and arrays, and the kernel's code reads the same names.
"""

from __future__ import annotations

import contextlib
import io
import linecache
import logging
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from typing import Annotated, Any, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from eldir.engine.compiler import NAME, new_kernel, ti
from eldir.engine.kernels import simd
from eldir.engine.threads import worker_threads

_logger = logging.getLogger(__name__)

COMPILER_LOCK = threading.RLock()
"""Held while the compiler starts, compiles or computes: it can do none of these in two threads at the same
time. A kernel uses all cores by itself, so Python threads that wait here lose nothing."""


Constant = Annotated[int, "constant"]
"""Known while compiling: each value has a kernel of its own."""
Count = Annotated[int, "i32"]
Number = Annotated[float, "real"]
Integers = Annotated[NDArray[np.int32], "i32[]"]
Values = Annotated[NDArray[Any], "real[]"]
"""An array of single numbers; below, the same in whole vectors of 1, 2, 4, 8, 16 and 32 numbers."""
Ones = Annotated[NDArray[Any], "1[]"]
Pairs = Annotated[NDArray[Any], "2[]"]
Quads = Annotated[NDArray[Any], "4[]"]
Eights = Annotated[NDArray[Any], "8[]"]
Lanes = Annotated[NDArray[Any], "16[]"]
Rows = Annotated[NDArray[Any], "32[]"]

Record = TypeVar("Record", bound=NamedTuple)

_SOURCE = """def launch_{name}({parameters}):
    ti.loop_config(block_dim={threads})
    for worker in range({threads} * workers):
        work(worker, ti.static({record}))
"""


def start() -> Any:
    """Initialise the compiler for this process, once, and return its module. Any thread may call it."""
    with COMPILER_LOCK:
        return _started()


@cache
def _started() -> Any:
    """The compiler, initialised.

    Matrices are kept in true vector registers. This is four times faster and compiles in a tenth of the time.
    Taichi does not document that option, so its version is pinned, and the engine continues without the
    option where vectors give wrong results.
    """
    initialise(vectors=True)
    if not simd.vectors_work():
        _logger.warning(
            "vector code does not work on this machine; the engine continues without it, "
            "four times slower, and its first start takes minutes"
        )
        ti.reset()
        initialise(vectors=False)
    return ti


def initialise(vectors: bool) -> None:
    """`make_cpu_multithreading_loop` is off: one task for each worker, which takes robots from a queue."""
    with contextlib.redirect_stdout(io.StringIO()):  # it prints its version in spite of all settings
        ti.init(
            arch=ti.cpu,
            cpu_max_num_threads=max(worker_threads(), os.cpu_count() or 1),
            default_fp=ti.f32,
            log_level=ti.ERROR,
            offline_cache=True,
            real_matrix_scalarize=not vectors,
            make_cpu_multithreading_loop=False,
            opt_level=0,  # without its quadratic search for equal expressions, which LLVM does again
            advanced_optimization=not vectors,  # its algebra; see `set_compile_options`
        )
    _logger.info("started %s with %d threads", NAME, worker_threads())


def set_compile_options(precision: str) -> None:
    """Set how kernels are compiled from now on. With Taichi the results keep their bytes.

    In float32, work that does not change within a loop is moved out of its branches too: rugged ground then
    takes 4 to 9 % less time, float64 10 % more. In float64 the compiler's own algebra saves 12 to
    25 % with AVX2; in float32 it saves a few per cent and compiling takes longer.
    """
    ti.cfg.move_loop_invariant_outside_if = precision == "f32"
    ti.cfg.advanced_optimization = precision == "f64" or ti.cfg.real_matrix_scalarize


def argument_types(real: Any) -> dict[str, Any]:
    """The compiler's type of each kind of field, for numbers of type `real`."""
    vectors = {f"{n}[]": ti.types.ndarray(ti.types.vector(n, real), ndim=1) for n in (1, 2, 4, 8, 16, 32)}
    return vectors | {
        "constant": ti.template(),
        "i32": ti.i32,
        "real": real,
        "i32[]": ti.types.ndarray(ti.i32, ndim=1),
        "real[]": ti.types.ndarray(real, ndim=1),
    }


def make_kernel(
    record: type[Record], types: Mapping[str, Any], work: Any, threads: int = 1
) -> Callable[[Record], None]:
    """A kernel that calls `work(worker, launch)` for each of `launch.workers` workers, in parallel. With
    several `threads` for each, which form a block on a device, it calls `work` with the number of a thread.

    Taichi accepts neither records nor `*args` as arguments of a kernel. The kernel's few lines are therefore
    generated here, one parameter for each field, and passed on to `work` as the same record.
    """
    fields = list(_fields(record, ""))
    source = _SOURCE.format(
        name=record.__name__,
        parameters=", ".join(f"{name}: types[{tag!r}]" for name, tag in fields),
        threads=threads,
        record=_construction(record, ""),
    )
    file = f"<kernel of {record.__module__}.{record.__name__}>"
    # Taichi reads it there.
    linecache.cache[file] = (
        len(source),
        None,
        source.splitlines(keepends=True),
        file,
    )
    scope = {"__name__": __name__, "ti": ti, "types": types, "work": work} | _records(record)
    exec(compile(source, file, "exec", dont_inherit=True), scope)
    kernel = new_kernel(scope["launch_" + record.__name__])

    def run(launch: Record) -> None:
        with COMPILER_LOCK:
            begun = time.perf_counter()
            kernel(*_leaves(launch))
            # The first time it is compiled, or loaded from the compiler's cache.
            _logger.debug("kernel of %s: %.3f s", record.__name__, time.perf_counter() - begun)

    return run


def _hints(record: type[Any]) -> dict[str, Any]:
    return get_type_hints(record, include_extras=True)


def _fields(record: type[Any], prefix: str) -> Iterator[tuple[str, str]]:
    """Name and kind of each argument, including those of records within the record."""
    for name, hint in _hints(record).items():
        if get_origin(hint) is Annotated:
            yield prefix + name, get_args(hint)[1]
        else:
            yield from _fields(hint, f"{prefix}{name}_")


def _records(record: type[Any]) -> dict[str, type[Any]]:
    """The record and those within it, by name."""
    found = {record.__name__: record}
    for hint in _hints(record).values():
        if get_origin(hint) is not Annotated:
            found |= _records(hint)
    return found


def _construction(record: type[Any], prefix: str) -> str:
    """The expression that builds the record from the kernel's arguments."""
    parts = []
    for name, hint in _hints(record).items():
        plain = get_origin(hint) is Annotated
        parts.append(prefix + name if plain else _construction(hint, f"{prefix}{name}_"))
    return f"{record.__name__}({', '.join(parts)})"


def _leaves(launch: Any) -> Iterator[Any]:
    for value in launch:
        if isinstance(value, tuple):
            yield from _leaves(value)
        else:
            yield value
