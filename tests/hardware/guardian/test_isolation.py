"""The guardian's process runs no code of the working directory or of the environment.

A board of another package must be installed, or lie in a folder of packages on the program's path: see
test_own_board.py.
"""

import os
import subprocess
import sys
from itertools import product

import pytest

from eldir_hardware.guardian._connection import clean_environment, import_path
from tests.hardware.emulated_rigs import HEAT, emulated, rig_file
from tests.paths import PACKAGES

SHORT = HEAT.replace("5.0", "0.5").replace("+ 20", "+ 1")
PLANTED = ("serial", "json", "numpy", "yaml", "sitecustomize", "usercustomize", "startup", "toy")
# In the guardian it leaves a trace; in any other program it becomes the module that it hides.
TRAP = """
import importlib, os, sys
if b"eldir-guardian" in open("/proc/self/cmdline", "rb").read():
    open({trace!r}, "a").write(__name__ + " ")
here, before = {folder!r}, sys.path[:]
sys.path[:] = [p for p in before if os.path.realpath(p) != here]
sys.modules.pop(__name__, None)
try:
    sys.modules[__name__] = importlib.import_module(__name__)
except ImportError:
    pass
sys.path[:] = before
"""


@pytest.fixture
def trap(tmp_path):
    """A working directory whose modules leave a trace if the guardian runs them."""
    for name in PLANTED:
        text = TRAP.format(trace=str(tmp_path / "ran"), folder=str(tmp_path))
        (tmp_path / f"{name}.py").write_text(text)
    (tmp_path / "drive.py").write_text(SHORT)
    return tmp_path


STARTS = {
    "-c": (["-c", SHORT], {}),
    "a script beside it": (["drive.py"], {}),
    "-m": (["-m", "drive"], {}),
    "as the command eldir": (["-P", "-c", SHORT], {}),
    "PYTHONPATH": (["-P", "-c", SHORT], {"PYTHONPATH": "{trap}", "PYTHONSTARTUP": "{trap}/startup.py"}),
    "an empty entry": (["-P", "-c", SHORT], {"PYTHONPATH": ":.", "PYTHONUSERBASE": "{trap}"}),
}


IN_BRIEF = {("-c", False), ("a script beside it", False), ("PYTHONPATH", True), ("an empty entry", False)}
"""What each puts on the program's path: nothing, the script's folder, a folder, the working directory."""


@pytest.mark.parametrize(
    ("how", "elsewhere"),
    [
        pytest.param(*pair, marks=[] if pair in IN_BRIEF else pytest.mark.stress)
        for pair in product(STARTS, [False, True])
    ],
)
def test_no_planted_module_runs_in_the_guardian(how, elsewhere, trap, tmp_path_factory):
    """However the program that heats was started."""
    begin, variables = STARTS[how]
    if elsewhere and "drive" in str(begin[-1]):
        pytest.skip("the script is not there")
    where = tmp_path_factory.mktemp("elsewhere") if elsewhere else trap
    with emulated("lcus") as board:
        path = rig_file(trap / "rig.yaml", "lcus", board.port)
        done = subprocess.run(
            [sys.executable, *begin, str(path)],
            cwd=where,
            env=os.environ | {n: v.format(trap=trap) for n, v in variables.items()},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert done.returncode == 0 and any(e.closed for e in board.contact_events), done.stderr
    ran = (trap / "ran").read_text() if (trap / "ran").exists() else ""
    assert not ran, f"the guardian ran {ran}"


def test_what_is_on_the_guardians_path(tmp_path, monkeypatch):
    everyone = tmp_path / "everyone"
    everyone.mkdir()
    everyone.chmod(0o777)
    own = tmp_path / "own"
    own.mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", ["", ".", str(tmp_path), "own", str(own), str(everyone), "/no/such"])
    assert import_path() == [str(own), *(str(PACKAGES[n].parent) for n in ("eldir", "eldir_hardware"))]
    monkeypatch.setenv("LD_PRELOAD", "evil.so")
    monkeypatch.setenv("PYTHONHASHSEED", "1")
    monkeypatch.setenv("LD_LIBRARY_PATH", f"{own}::{tmp_path}")
    kept = clean_environment()
    assert kept["PYDANTIC_DISABLE_PLUGINS"] == "__all__", "any package may have one"
    assert kept["LD_LIBRARY_PATH"] == str(own) and "XDG_STATE_HOME" in kept
    assert not [n for n in kept if n.startswith("PYTHON") or n == "LD_PRELOAD"]
