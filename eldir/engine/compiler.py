"""The compiler of all kernels, loaded without its greeting. Only this module may import one.

The same kernels are compiled by Taichi and by Quadrants: `eldir.core.kernels` chooses.
"""

from __future__ import annotations

import os
import warnings
from importlib import import_module

from eldir.core.kernels import compiler_name
from eldir.errors import MissingDependencyError

NAME = compiler_name()
"""taichi | quadrants"""

os.environ["ENABLE_TAICHI_HEADER_PRINT"] = "0"  # they print their versions when imported
os.environ["ENABLE_QUADRANTS_HEADER_PRINT"] = "0"
try:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ti = import_module(NAME)
        Expr = import_module(f"{NAME}.lang.expr").Expr
        _impl = import_module(f"{NAME}.lang.impl")
        expr_init, subscript = _impl.expr_init, _impl.subscript
except ImportError as error:
    raise MissingDependencyError(
        f"{NAME} cannot be loaded", found=str(error), remedy=f"install it again: pip install --force {NAME}"
    ) from None

__all__ = ["NAME", "Expr", "expr_init", "subscript", "ti"]
