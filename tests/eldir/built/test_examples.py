"""The examples in docstrings of the public API run and show what they say."""

from __future__ import annotations

import doctest
from types import ModuleType

import pytest

from eldir.built import sensitivities, walking


@pytest.mark.parametrize("module", [sensitivities, walking], ids=lambda m: m.__name__)
def test_examples_in_docstrings_run(module: ModuleType) -> None:
    found = doctest.testmod(module)
    assert found.attempted > 5 and not found.failed
