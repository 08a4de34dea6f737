"""The compiler of all kernels, loaded without its greeting, and arrays as its vectors need them. Only this
module may import a compiler.

The same kernels are compiled by Taichi and by Quadrants: `eldir.core.kernels` chooses.
"""

from __future__ import annotations

import os
import warnings
from functools import cache
from importlib import import_module
from types import CodeType, FunctionType
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from eldir.core.kernels import compiler_name
from eldir.errors import MissingDependencyError

NAME = compiler_name()
"""taichi | quadrants"""
ALIGNMENT = 128
"""Alignment of arrays [bytes]: the compilers load whole vectors and crash on anything less aligned."""


def aligned(size: int, dtype: DTypeLike) -> NDArray[Any]:
    """Zeros, shape (size,), at an address from which vectors can be loaded."""
    kind = np.dtype(dtype)
    raw = np.zeros(size * kind.itemsize + ALIGNMENT, np.uint8)
    first = -raw.ctypes.data % ALIGNMENT
    return raw[first : first + size * kind.itemsize].view(kind)


def _cache_source_lines(reader: Any) -> None:
    """The compilers read a function's source from its file each time that a kernel calls it: read it once."""
    lines = reader.getsourcelines

    @cache
    def lines_of(code: CodeType) -> tuple[list[str], int]:
        found: tuple[list[str], int] = lines(code)
        return found

    def getsourcelines(function: FunctionType) -> tuple[list[str], int]:
        return lines_of(function.__code__)

    reader.getsourcelines = getsourcelines


def _shorten_positions(context: Any, name: str) -> None:
    """The compilers note the source position of each expression for their error messages, wrapped to 80
    columns. The wrapping takes half of the time in which Taichi builds its tree. It is left out here."""

    def place(self: Any, node: Any) -> str:
        line = self.src[node.lineno - 1].rstrip()
        begin = self.indent + node.col_offset
        end = self.indent + node.end_col_offset if node.end_lineno == node.lineno else len(line)
        where = f'File "{self.file}", line {node.lineno + self.lineno_offset}, in {self.func.func.__name__}'
        return f"{where}:\n{line}\n{' ' * begin}{'^' * (end - begin)}\n"

    setattr(context, name, place)


def _skip_class_search(kernels: Any) -> None:
    """For each decorated function the compilers search all modules for the source of a class around it. The
    engine's functions are in none."""
    kernels._inside_class = lambda level_of_class_stackframe: False


os.environ["ENABLE_TAICHI_HEADER_PRINT"] = "0"  # they print their versions when imported
os.environ["ENABLE_QUADRANTS_HEADER_PRINT"] = "0"
try:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ti = import_module(NAME)
        Expr = import_module(f"{NAME}.lang.expr").Expr
        _impl = import_module(f"{NAME}.lang.impl")
        expr_init, subscript = _impl.expr_init, _impl.subscript
    _contexts = import_module(f"{NAME}.lang.ast.ast_transformer_utils")
    _skip_class_search(import_module(f"{NAME}.lang.kernel_impl"))
    if NAME == "taichi":
        _cache_source_lines(import_module("taichi.lang.kernel_impl"))
        _shorten_positions(_contexts.ASTTransformerContext, "get_pos_info")
    else:
        _cache_source_lines(import_module("quadrants.lang._wrap_inspect"))
        _shorten_positions(_contexts.ASTTransformerFuncContext, "_build_pos_info")
except ImportError as error:
    raise MissingDependencyError(
        f"{NAME} cannot be loaded", found=str(error), remedy=f"install it again: pip install --force {NAME}"
    ) from None

__all__ = ["ALIGNMENT", "NAME", "Expr", "aligned", "expr_init", "subscript", "ti"]
