"""Damaged files of every kind: one clear line, no traceback, no hang. `make stress` tries 100 000 of each."""

from pathlib import Path

import pytest

from eldir.errors import EldirError
from tests.product.fuzzing import FORMATS, faults

TRIES = 60


@pytest.mark.parametrize("name", FORMATS)
def test_damaged_files_are_refused_in_words(name: str, tmp_path: Path) -> None:
    found = faults(name, tmp_path, TRIES, seed=0)
    assert not found, "\n".join(map(str, found[:5]))


def test_what_was_found_stays_on_one_readable_line() -> None:
    said = str(EldirError("wrong", expected="a number", found="x\n" * 10_000, remedy="mend it"))
    assert "\n" not in said and len(said) < 500 and said.endswith("...; mend it")
