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
    """For each expression Taichi writes down where it stands, in case of an error, and wraps these lines to
    80 columns. That takes half of the time for its tree. The lines here are not wrapped."""

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
