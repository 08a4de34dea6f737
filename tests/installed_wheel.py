"""The wheel in an environment of its own: built from the sdist, with its dependencies and nothing else."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.made_once import made_once
from tests.paths import PACKAGES, ROOT

_UV = Path(sys.executable).with_name("uv")


class Installation(NamedTuple):
    """Where things are."""

    wheel: Path
    programs: Path
    """Folder of `python` and `eldir`."""

    def run(self, program: str, *arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
        """A program of the environment, in a folder outside the checkout."""
        assert not folder.is_relative_to(ROOT)
        hidden = ("ELDIR_COMPILER", "PYTHONPATH", "PYTHONDONTWRITEBYTECODE", "VIRTUAL_ENV")
        return subprocess.run(
            [self.programs / program, *arguments],
            capture_output=True, text=True, check=False, cwd=folder,
            env={k: v for k, v in os.environ.items() if k not in hidden},
        )  # fmt: skip


def installation(temporary: pytest.TempPathFactory) -> Installation:
    """Made once in a run of the tests, for all its processes."""
    return made_once(temporary, "installation", lambda: _install(temporary.mktemp("installation")))


def _install(folder: Path) -> Installation:
    tree = folder / "tree"  # setuptools leaves files beside the sources
    tree.mkdir()
    for name in ("pyproject.toml", "MANIFEST.in", "README.md", "CHANGELOG.md", "LICENSE"):
        shutil.copy(ROOT / name, tree)
    without_caches = shutil.ignore_patterns("__pycache__")
    for package in PACKAGES.values():
        shutil.copytree(package, tree / package.relative_to(ROOT), ignore=without_caches)
    _uv("build", "--out-dir", str(folder), str(tree))  # the sdist, then the wheel from the sdist
    (wheel,) = folder.glob("*.whl")
    environment = folder / "environment"
    _uv("venv", "--python", sys.executable, str(environment))
    programs = environment / "bin"
    constraints = str(ROOT / ".ci" / "constraints.txt")
    # With MuJoCo, as `make demo`.
    _uv("pip", "install", "--python", str(programs / "python"), "-c", constraints, f"{wheel}[mujoco]")
    return Installation(wheel, programs)


def _uv(*arguments: str) -> None:
    """Run uv; where the package index is out of reach, with what is in its cache."""
    for offline in ((), ("--offline",)):
        result = subprocess.run(
            [_UV, "--quiet", *offline, *arguments], capture_output=True, text=True, check=False
        )
        if result.returncode == 0:
            return
    pytest.fail(f"uv {arguments[0]}: {result.stderr}")
