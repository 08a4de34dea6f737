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


def _word_once(context: Any) -> None:
    """Taichi words where each expression stands, for errors that hardly ever occur, anew for each use of a
    function: half of the time that it takes for its tree. Quadrants keeps the words, and so does this."""
    word, kept = context.get_pos_info, dict[tuple[Any, ...], str]()

    def get_pos_info(self: Any, node: Any) -> str:
        begin, end = (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)
        key = (self.file, self.lineno_offset, self.func.func.__name__, type(node), begin, end)
        if key not in kept:
            kept[key] = word(self, node)
        return kept[key]

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
        _word_once(import_module("taichi.lang.ast.ast_transformer_utils").ASTTransformerContext)
except ImportError as error:
    raise MissingDependencyError(
        f"{NAME} cannot be loaded", found=str(error), remedy=f"install it again: pip install --force {NAME}"
    ) from None

__all__ = ["NAME", "Expr", "expr_init", "subscript", "ti"]
