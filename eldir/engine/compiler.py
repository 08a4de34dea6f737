"""The compiler of all kernels, loaded without its greeting. Only this module may import one.

The same kernels are compiled by Taichi and by Quadrants: `eldir.core.kernels` chooses.
"""

from __future__ import annotations

import os
import warnings
from importlib import import_module
from typing import Any

from eldir.core.kernels import compiler_name
from eldir.errors import MissingDependencyError

NAME = compiler_name()
"""taichi | quadrants"""


def _word_briefly(context: Any) -> None:
    """Taichi words where each expression stands, for errors that hardly ever occur, and wraps the words to 80
    columns: half of the time that it takes for its tree. Here is no need to wrap."""

    def get_pos_info(self: Any, node: Any) -> str:
        line = self.src[node.lineno - 1].rstrip()
        begin = self.indent + node.col_offset
        end = self.indent + node.end_col_offset if node.end_lineno == node.lineno else len(line)
        place = f'File "{self.file}", line {node.lineno + self.lineno_offset}, in {self.func.func.__name__}'
        return f"{place}:\n{line}\n{' ' * begin}{'^' * (end - begin)}\n"

    context.get_pos_info = get_pos_info


os.environ["ENABLE_TAICHI_HEADER_PRINT"] = "0"  # they print their versions when imported
os.environ["ENABLE_QUADRANTS_HEADER_PRINT"] = "0"
try:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ti = import_module(NAME)
        Expr = import_module(f"{NAME}.lang.expr").Expr
        _impl = import_module(f"{NAME}.lang.impl")
        expr_init, subscript = _impl.expr_init, _impl.subscript
    if NAME == "taichi":
        _word_briefly(import_module("taichi.lang.ast.ast_transformer_utils").ASTTransformerContext)
except ImportError as error:
    raise MissingDependencyError(
        f"{NAME} cannot be loaded", found=str(error), remedy=f"install it again: pip install --force {NAME}"
    ) from None

__all__ = ["NAME", "Expr", "expr_init", "subscript", "ti"]
