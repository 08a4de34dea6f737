"""The bench of two test modules."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from eldir.errors import EldirError
from tests.calibration.adaptation.hidden_bench import Bench, files
from tests.calibration.adaptation.short_adaptation import shorten
from tests.made_once import made_once


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    """After an adaptation whose second run failed, and which went on."""

    def make() -> Bench:
        made = Bench(tmp_path_factory.mktemp("bench"))
        made.fails_in_run = 2
        with pytest.raises(EldirError, match="the supply has failed"):
            made.adapt()
        made.fails_in_run, made.decided = 0, files(made.folder / "out" / "run_02")
        made.adapt()
        return made

    with pytest.MonkeyPatch.context() as shorter:  # how far it walks in the end is no matter here
        shorten(shorter.setattr)
        yield made_once(tmp_path_factory, "adaptation", make)
