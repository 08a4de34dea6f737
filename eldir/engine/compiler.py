"""The compiler of all kernels, loaded without its greeting. Only this module may import one.

The same kernels are compiled by Taichi and by Quadrants: `eldir.core.kernels` chooses.
"""

from __future__ import annotations

import os
import warnings
from functools import cache
from importlib import import_module
from types import CodeType, FunctionType
from typing import Any

from eldir.core.kernels import compiler_name
from eldir.errors import MissingDependencyError

NAME = compiler_name()
"""taichi | quadrants"""


def _read_once(reader: Any) -> None:
    """The compilers search a function's lines in its file each time that it is called in a kernel."""
    lines = reader.getsourcelines

    @cache
    def lines_of(code: CodeType) -> tuple[list[str], int]:
        found: tuple[list[str], int] = lines(code)
        return found

    def getsourcelines(function: FunctionType) -> tuple[list[str], int]:
        return lines_of(function.__code__)

    reader.getsourcelines = getsourcelines


def _word_briefly(context: Any, name: str) -> None:
    """For each expression the compilers write down where it stands, in case of an error, and wrap these lines
    to 80 columns. That takes half of Taichi's time for its tree. The lines here are not wrapped."""

    def place(self: Any, node: Any) -> str:
        line = self.src[node.lineno - 1].rstrip()
        begin = self.indent + node.col_offset
        end = self.indent + node.end_col_offset if node.end_lineno == node.lineno else len(line)
        where = f'File "{self.file}", line {node.lineno + self.lineno_offset}, in {self.func.func.__name__}'
        return f"{where}:\n{line}\n{' ' * begin}{'^' * (end - begin)}\n"

    setattr(context, name, place)


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
    if NAME == "taichi":
        _read_once(import_module("taichi.lang.kernel_impl"))
        _word_briefly(_contexts.ASTTransformerContext, "get_pos_info")
    else:
        _read_once(import_module("quadrants.lang._wrap_inspect"))
        _word_briefly(_contexts.ASTTransformerFuncContext, "_build_pos_info")
except ImportError as error:
    raise MissingDependencyError(
        f"{NAME} cannot be loaded", found=str(error), remedy=f"install it again: pip install --force {NAME}"
    ) from None

__all__ = ["NAME", "Expr", "expr_init", "subscript", "ti"]
