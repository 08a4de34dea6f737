"""Folders of the repository that tests read."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
SCHEMAS = ROOT / "docs" / "schemas"
DATA = ROOT / "tests" / "data"
