"""Fixtures of several test modules: films of marks, and a state folder of a test's own."""

from pathlib import Path

import pytest

from tests.hardware.vision.walking_films import filmed, first_film, recordings  # noqa: F401


@pytest.fixture
def state_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of latched stops and warm springs, which is this test's own; nobody has made it yet."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state" / "eldir"
