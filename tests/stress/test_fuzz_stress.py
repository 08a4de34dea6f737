"""100 000 damaged files of every kind."""

import os
import time
from pathlib import Path

import pytest

from tests.product.fuzzing import FORMATS, faults

pytestmark = pytest.mark.stress
TRIES = int(os.environ.get("TRIES", "100000"))


@pytest.mark.parametrize("name", FORMATS)
def test_damaged_files_are_refused_in_words(name: str, tmp_path: Path) -> None:
    """The first seeds are those of the normal suite."""
    began = time.monotonic()
    found = faults(name, tmp_path, TRIES, seed=0)
    print(f"{name}: {TRIES} files, {time.monotonic() - began:.0f} s, {len(found)} faults")
    assert not found, "\n".join(map(str, found[:20]))
