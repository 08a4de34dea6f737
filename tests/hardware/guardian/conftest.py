"""The guardian that tests of its client play, and the wire to the guardian's process."""

import pytest

from tests.hardware.guardian.recording_controller import signals, wires  # noqa: F401
from tests.hardware.guardian.scripted_guardian import scripted_guardian


@pytest.fixture
def desk(tmp_path, monkeypatch):
    with scripted_guardian(tmp_path, monkeypatch) as made:
        yield made
