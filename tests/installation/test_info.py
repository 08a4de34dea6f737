"""`eldir info` and `eldir --version`: what is here, what is missing, and nothing loaded or opened for it."""

import json
import os
import platform
import resource
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from eldir.core.version import __version__
from tests.installed_wheel import installation
from tests.paths import SCHEMAS

HEAVY = (
    "taichi",
    "quadrants",
    "numpy",
    "scipy",
    "cv2",
    "trimesh",
    "matplotlib",
    "mujoco",
    "rosbags",
    "serial",
)


def eldir(*arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "eldir", *arguments],
        capture_output=True, text=True, check=False, env={**os.environ, **variables},
    )  # fmt: skip


def valid(text: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(text)
    jsonschema.validate(found, json.loads((SCHEMAS / "info.schema.json").read_text()))
    return found


def test_it_says_what_is_here() -> None:
    found = valid(eldir("info", "--json").stdout)
    assert found["eldir"]["version"] == __version__
    assert found["python"]["version"] == platform.python_version()
    for name in ("numpy", "opencv-python-headless", "rosbags"):
        assert found["libraries"][name] == version(name)
    assert None not in found["libraries"].values()
    assert found["compiler"]["chosen"] in found["compiler"]["installed"]
    assert found["platform"]["cores"] == len(os.sched_getaffinity(0))
    text = eldir("info").stdout
    for word in (__version__, platform.machine(), f"numpy {version('numpy')}", found["eldir"]["source"]):
        assert word in text


def test_the_version_comes_first_and_the_libraries_follow() -> None:
    first, second = eldir("--version").stdout.splitlines()
    assert first == f"eldir {__version__}"
    assert f"numpy {version('numpy')}" in second and f"Python {platform.python_version()}" in second


def test_it_loads_nothing_heavy_and_takes_no_time() -> None:
    code = (
        "import sys; sys.argv[1:] = ['info']; from eldir_app.application import run_application;"
        f"run_application(); print([m for m in {HEAVY} if m in sys.modules])"
    )
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert said.splitlines()[-1] == "[]"
    assert after.ru_utime - before.ru_utime < 2.0, "processor seconds; 0.3 on a quiet machine"


def test_a_compiler_that_is_not_there_is_told_and_no_failure() -> None:
    result = eldir("info", "--json", ELDIR_COMPILER="gcc")
    assert result.returncode == 0 and result.stderr == ""
    found = valid(result.stdout)
    assert found["compiler"]["chosen"].startswith("none: invalid ELDIR_COMPILER")
    assert found["variables"]["ELDIR_COMPILER"] == "gcc"


def test_wrong_arguments_end_with_status_2() -> None:
    for words in (("info", "everything"), ("info", "--xml")):
        result = eldir(*words)
        assert result.returncode == 2 and len(result.stderr.strip().splitlines()) == 1


def test_a_missing_extra_comes_with_its_remedy(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path
) -> None:
    """The wheel's environment holds the extra mujoco alone."""
    here = installation(tmp_path_factory)
    text = here.run("eldir", "info", folder=tmp_path).stdout
    assert "extra      mujoco: mujoco-core " in text
    for extra in ("watch", "cluster", "quadrants"):
        assert f"extra      {extra}: not installed: pip install 'eldir[{extra}]'" in text
    found = valid(here.run("eldir", "info", "--json", folder=tmp_path).stdout)
    assert found["extras"]["watch"] == {"starlette": None, "uvicorn": None, "websockets": None}
    assert Path(found["eldir"]["folder"]).is_relative_to(here.programs.parent)


def test_the_tab_key_completes_commands() -> None:
    words = {"_ELDIR_COMPLETE": "complete_bash", "COMP_WORDS": "eldir inf", "COMP_CWORD": "1"}
    code = "import sys; sys.argv[0] = 'eldir'; from eldir_app.main import main; main()"
    said = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, **words}, check=False
    )
    assert said.stdout.split() == ["info"]


def test_windows_gets_one_line() -> None:
    """The platform's name is changed before the command starts; all that it then does is to say so."""
    code = "import sys; sys.platform = 'win32'; from eldir_app.main import main; main()"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode == 1 and result.stdout == ""
    assert result.stderr == "eldir: eldir does not run on Windows; expected Linux; use WSL or a container\n"
