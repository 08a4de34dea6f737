"""NVIDIA's assembler and disassembler, which the extra `test` brings for Linux."""

import pytest

from benchmarks.assembly import find_tool
from eldir.errors import MissingDependencyError


def require_tool(name: str) -> None:
    """Skip the test where `ptxas` or `nvdisasm` is not installed; the reason says how to."""
    try:
        find_tool(name)
    except MissingDependencyError as error:
        pytest.skip(str(error))
