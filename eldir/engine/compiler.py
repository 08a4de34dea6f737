"""The compiler of all kernels, Taichi, loaded without its greeting. Only this module may import it."""

from __future__ import annotations

import os
import warnings

from eldir.errors import MissingDependencyError

os.environ["ENABLE_TAICHI_HEADER_PRINT"] = "0"  # it prints its version when imported
try:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import taichi as ti
        from taichi.lang.expr import Expr
        from taichi.lang.impl import expr_init, subscript
except ImportError as error:
    raise MissingDependencyError(
        "the engine needs taichi, which is not installed here",
        found=str(error),
        remedy="install it on x86-64 with Python 3.11 to 3.13; the rig works without it",
    ) from None

__all__ = ["Expr", "expr_init", "subscript", "ti"]
