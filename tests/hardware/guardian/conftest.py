"""The guardian that tests of its client play."""

import pytest

from tests.hardware.guardian.scripted_guardian import scripted_guardian


@pytest.fixture
def desk(tmp_path, monkeypatch):
    with scripted_guardian(tmp_path, monkeypatch) as made:
        yield made
