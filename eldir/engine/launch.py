"""Launching a kernel with one record: its fields are the kernel's arguments, declared once for both sides.

A record is a `NamedTuple`. Each field is annotated with one of the types below, or with another record. The
host fills the record with numbers and arrays, and the kernel's code reads the same names.
"""

from __future__ import annotations

import linecache
import logging
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Annotated, Any, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from eldir.engine.compiler import ti
from eldir.engine.runtime import ONE_AT_A_TIME

_logger = logging.getLogger(__name__)

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


def kernel_of(
    record: type[Record], types: Mapping[str, Any], work: Any, threads: int = 1
) -> Callable[[Record], None]:
    """A kernel that calls `work(worker, launch)` for each of `launch.workers` workers, in parallel. With
    several `threads` for each, which form a block on a device, it calls `work` with the number of a thread.

    Taichi accepts neither records nor `*args` as arguments of a kernel. The kernel's few lines are therefore
    written here, one parameter for each field, and passed on to `work` as the record that they came from.
    """
    fields = list(_fields(record, ""))
    source = _SOURCE.format(
        name=record.__name__,
        parameters=", ".join(f"{name}: types[{tag!r}]" for name, tag in fields),
        threads=threads,
        record=_construction(record, ""),
    )
    file = f"<kernel of {record.__module__}.{record.__name__}>"
    linecache.cache[file] = (
        len(source),
        None,
        source.splitlines(keepends=True),
        file,
    )  # Taichi reads it there
    scope = {"__name__": __name__, "ti": ti, "types": types, "work": work} | _records(record)
    exec(compile(source, file, "exec", dont_inherit=True), scope)
    kernel = ti.kernel(scope["launch_" + record.__name__])

    def run(launch: Record) -> None:
        with ONE_AT_A_TIME:
            begun = time.perf_counter()
            kernel(*_leaves(launch))
            # The first time it is compiled, or loaded from the compiler's cache.
            _logger.debug("kernel of %s: %.3f s", record.__name__, time.perf_counter() - begun)

    return run


def _hints(record: type[Any]) -> dict[str, Any]:
    return get_type_hints(record, include_extras=True)


def _fields(record: type[Any], prefix: str) -> Iterator[tuple[str, str]]:
    """Name and kind of each argument, records within the record included."""
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
    """The expression that makes the record of the kernel's arguments again."""
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
