"""The sheet for a camera's calibration is the one that was asked for, and the message has its size."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from eldir_app.application import application


def print_sheet(path: Path, *words: str) -> Result:
    arguments = ["calibrate", "camera", "--sheet", str(path / "sheet.pdf"), *words]
    return CliRunner().invoke(application("calibrate"), arguments)


@pytest.mark.parametrize(("words", "width"), [((), "250 mm"), (("--square-mm", "18"), "180 mm")])
def test_the_message_has_the_width_of_ten_squares(tmp_path: Path, words: tuple[str, ...], width: str) -> None:
    found = print_sheet(tmp_path, *words)
    assert found.exit_code == 0 and f"ten squares are {width} wide" in found.output, found.output


def test_a_chessboard_is_not_printed(tmp_path: Path) -> None:
    """A ChArUco sheet of 6 x 5 squares is no chessboard with 6 x 5 inner corners."""
    found = print_sheet(tmp_path, "--chessboard", "6x5")
    assert found.exit_code == 2 and "remove --chessboard" in found.output
    assert not list(tmp_path.iterdir())
