"""Damaged files of every kind: one clear line, no traceback, no hang. `make stress` tries 100 000 of each."""

from pathlib import Path

import pytest

from tests.product.fuzzing import FORMATS, faults

TRIES = 60


@pytest.mark.parametrize("name", FORMATS)
def test_damaged_files_are_refused_in_words(name: str, tmp_path: Path) -> None:
    found = faults(name, tmp_path, TRIES, seed=0)
    assert not found, "\n".join(map(str, found[:5]))
