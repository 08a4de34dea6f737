"""The compiler of all kernels, loaded without its greeting, and arrays as its vectors need them. Only this
module may import a compiler.

The same kernels are compiled by Taichi and by Quadrants: `eldir.core.kernels` chooses.
"""

from __future__ import annotations

import inspect
import linecache
import os
import warnings
from collections.abc import Callable
from functools import cache
from importlib import import_module
from types import CodeType
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


def _read_source_once(reader: Any) -> None:
    """For each call of a function in a kernel the compilers read its source again, and search all modules
    for its own. Here its file is read, once."""
    lines, file = reader.getsourcelines, cache(reader.getsourcefile)

    @cache
    def lines_of(code: CodeType) -> tuple[list[str], int]:
        rest = linecache.getlines(code.co_filename)[code.co_firstlineno - 1 :]
        found: tuple[list[str], int] = (inspect.getblock(rest), code.co_firstlineno) if rest else lines(code)
        return found

    reader.getsourcelines = lambda function: lines_of(function.__code__)
    reader.getsourcefile = lambda function: file(function.__code__)


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


def new_kernel(function: Callable[..., None]) -> Any:
    """The function as a kernel."""
    kernel = ti.kernel(function)
    if NAME == "quadrants":
        _translate_once(kernel._primal)
    return kernel


def _translate_once(kernel: Any) -> None:
    """Quadrants translates a kernel twice: the first time to find which fields it uses of the records among
    its arguments, which is known of a kernel from its cache of sources. Ours have no records as arguments."""
    load = kernel._try_load_fastcache

    def used_fields(arguments: Any, key: Any) -> set[str]:
        used: set[str] = load(arguments, key) or set()
        kernel.used_py_dataclass_parameters_by_key_enforcing[key] = used
        return used

    kernel._try_load_fastcache = used_fields


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
        _read_source_once(import_module("taichi.lang.kernel_impl"))
        _shorten_positions(_contexts.ASTTransformerContext, "get_pos_info")
    else:
        _read_source_once(import_module("quadrants.lang._wrap_inspect"))
        _shorten_positions(_contexts.ASTTransformerFuncContext, "_build_pos_info")
except ImportError as error:
    raise MissingDependencyError(
        f"{NAME} cannot be loaded", found=str(error), remedy=f"install it again: pip install --force {NAME}"
    ) from None

__all__ = ["ALIGNMENT", "NAME", "Expr", "aligned", "expr_init", "new_kernel", "subscript", "ti"]
