"""The Dockerfiles copy what is there, and what they need is not ignored."""

import re
from pathlib import Path

import pytest

from tests.paths import ROOT

KEPT = [line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")]
FILES = sorted((ROOT / "docker").glob("*.Dockerfile"))


def test_what_is_kept_is_there_and_is_what_the_wheel_is_built_from() -> None:
    assert all((ROOT / name).exists() for name in KEPT)
    for name in ("pyproject.toml", "README.md", "LICENSE", "eldir", "app", "cad", "calibration", "hardware"):
        assert name in KEPT


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.name)
def test_what_is_copied_and_named_reaches_the_image(path: Path) -> None:
    text = path.read_text()
    copied = re.findall(r"^COPY (?!--from)(\S+) ", text, re.MULTILINE)
    assert copied and set(copied) - {"."} <= set(KEPT)
    for name in re.findall(r"-c /source/(\S+)", text):
        assert name in KEPT
    assert re.search(r"^USER (?!root)", text, re.MULTILINE), "heat and files: not as root"
