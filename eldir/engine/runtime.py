"""Starting Taichi once."""

from __future__ import annotations

import contextlib
import io
import logging
import os
import threading
from functools import cache
from typing import Any

from eldir.engine import selfcheck
from eldir.engine.compiler import NAME, ti
from eldir.engine.threads import worker_threads

_logger = logging.getLogger(__name__)

ONE_AT_A_TIME = threading.RLock()
"""Held while the compiler starts, compiles or computes: it can do none of these twice at the same time. A
kernel uses all cores by itself, so Python threads that wait for each other here lose nothing."""


def start() -> Any:
    """Initialise Taichi for this process, once, and return the module. Any thread may call it."""
    with ONE_AT_A_TIME:
        return _started()


@cache
def _started() -> Any:
    """Taichi, initialised.

    Matrices are kept in true vector registers. This is four times faster and compiles in a tenth of the time.
    Taichi does not document that option, so its version is pinned, and the engine continues without the
    option where vectors give wrong results.
    """
    _initialise(vectors=True)
    if not selfcheck.vectors_work():
        _logger.warning(
            "vector code does not work on this machine; the engine continues without it, "
            "four times slower, and its first start takes minutes"
        )
        ti.reset()
        _initialise(vectors=False)
    return ti


def _initialise(vectors: bool) -> None:
    """One task for each worker (`make_cpu_multithreading_loop`); workers take robots from a queue."""
    with contextlib.redirect_stdout(io.StringIO()):  # it greets whatever one asks
        ti.init(
            arch=ti.cpu,
            cpu_max_num_threads=max(worker_threads(), os.cpu_count() or 1),
            default_fp=ti.f32,
            log_level=ti.ERROR,
            offline_cache=True,
            real_matrix_scalarize=not vectors,
            make_cpu_multithreading_loop=False,
            opt_level=0,  # without its quadratic search for equal expressions, which LLVM does again
            advanced_optimization=not vectors,  # its algebra; see `prefer`
        )
    _logger.info("started %s with %d threads", NAME, worker_threads())


def prefer(precision: str) -> None:
    """Set how kernels are compiled from now on. With Taichi the results keep their bytes.

    In float32, work that does not change within a loop is moved out of its branches too: rugged ground then
    takes 4 to 9 % less time, float64 10 % more. In float64 the compiler's own algebra saves 12 to
    25 % with AVX2; in float32 it saves a few per cent and compiling takes longer.
    """
    ti.cfg.move_loop_invariant_outside_if = precision == "f32"
    ti.cfg.advanced_optimization = precision == "f64" or ti.cfg.real_matrix_scalarize
