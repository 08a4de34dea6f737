"""A report that several modules look at."""

from pathlib import Path

import pytest

from eldir_calibration.report.page import write_report
from tests.calibration.report.report_input import content


@pytest.fixture(scope="session")
def plain_report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the simplest report, to be read only."""
    folder = tmp_path_factory.mktemp("plain") / "report"
    write_report(content(), folder)
    return folder
