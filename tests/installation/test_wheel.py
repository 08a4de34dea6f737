"""The wheel holds the packages of the checkout, byte for byte, and works where there is no checkout."""

import json
import re
import zipfile
from pathlib import Path

import pytest

from tests.installed_wheel import Installation, installation
from tests.paths import PACKAGES, ROOT


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installation:
    return installation(tmp_path_factory)


def test_the_wheel_from_the_sdist_holds_every_file_of_the_packages(installed: Installation) -> None:
    """Python and data: what `importlib.resources` and `__file__` reach in the checkout is there."""
    tree = {
        path.relative_to(package.parent).as_posix(): path.read_bytes()
        for package in PACKAGES.values()
        for path in package.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    with zipfile.ZipFile(installed.wheel) as wheel:
        held = {name: wheel.read(name) for name in wheel.namelist() if ".dist-info/" not in name}
    assert sorted(tree) == sorted(held)
    assert [name for name in tree if tree[name] != held[name]] == []
    assert len([name for name in tree if not name.endswith(".py")]) >= 15, "data files"


def test_the_environment_is_not_the_checkout(installed: Installation, tmp_path: Path) -> None:
    code = (
        "import json, sys, eldir, eldir_app, eldir_cad, eldir_calibration, eldir_hardware;"
        "found = [m.__file__ for m in (eldir, eldir_app, eldir_cad, eldir_calibration, eldir_hardware)];"
        "print(json.dumps([sys.path, found]))"
    )
    result = installed.run("python", "-c", code, folder=tmp_path)
    paths, files = json.loads(result.stdout)
    site = installed.programs.parent / "lib"
    assert all(Path(file).is_relative_to(site) for file in files)
    assert not any(Path(path).is_relative_to(ROOT) for path in paths)


def test_every_command_is_there(installed: Installation, tmp_path: Path) -> None:
    result = installed.run("eldir", "--help", folder=tmp_path)
    assert result.returncode == 0 and result.stderr == ""
    for name in re.findall(r"^\| `eldir ([a-z]+)`", (ROOT / "README.md").read_text(), re.MULTILINE):
        assert re.search(rf"\b{name}\b", result.stdout), name
