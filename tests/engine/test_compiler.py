"""Which compiler the kernels are written for."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

CHOSEN = "from eldir.engine.compiler import NAME, ti; print(NAME, ti.__name__)"
TOLD = """
from eldir.errors import EldirError
try:
    import eldir.engine.compiler
except EldirError as error:
    print(error)
"""
MISSING = "import sys; sys.modules.update(dict.fromkeys({!r})); "
"""Python treats a module that is None as one that is not installed."""


def python(code: str, asked: str | None) -> subprocess.CompletedProcess[str]:
    environment = {k: v for k, v in os.environ.items() if k != "ELDIR_COMPILER"}
    if asked is not None:
        environment["ELDIR_COMPILER"] = asked
    return subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize(
    ("asked", "missing", "chosen"),
    [
        (None, [], "taichi"),
        ("", [], "taichi"),
        ("quadrants", [], "quadrants"),
        (None, ["taichi"], "quadrants"),
        (None, ["quadrants"], "taichi"),
    ],
)
def test_taichi_unless_asked_or_missing(asked: str | None, missing: list[str], chosen: str) -> None:
    if find_spec(chosen) is None:
        pytest.skip(f"{chosen} is not installed here")
    ran = python(MISSING.format(missing) + CHOSEN, asked)
    assert (ran.stdout, ran.stderr) == (f"{chosen} {chosen}\n", "")


@pytest.mark.parametrize(
    ("asked", "missing", "said"),
    [
        ("numba", [], "ELDIR_COMPILER is wrong; expected taichi or quadrants; found 'numba'"),
        ("quadrants", ["quadrants"], "asks for quadrants, which is not installed here"),
        (None, ["taichi", "quadrants"], "neither is installed here; pip install 'eldir[quadrants]'"),
    ],
)
def test_what_cannot_be_had_is_told_in_one_line(asked: str | None, missing: list[str], said: str) -> None:
    ran = python(MISSING.format(missing) + TOLD, asked)
    assert said in " ".join(ran.stdout.split()) and ran.stderr == ""


def test_an_error_in_a_kernel_tells_where_it_stands(tmp_path: Path) -> None:
    """In the second use of a function too."""
    (tmp_path / "kernel.py").write_text(
        "from eldir.engine import runtime\n"
        "from eldir.engine.compiler import ti\n"
        "@ti.func\n"
        "def half(x: ti.template()):\n"
        "    return x[0] / 2\n"
        "@ti.kernel\n"
        "def kernel(x: ti.types.ndarray()):\n"
        "    first, second = half(x), half(1.0)\n"
        "runtime.start()\n"
        "import numpy as np\n"
        "kernel(np.zeros(3))\n"
    )
    ran = subprocess.run(
        [sys.executable, str(tmp_path / "kernel.py")], capture_output=True, text=True, check=False
    )
    assert ran.returncode == 1
    for place in ("line 5, in half", "return x[0] / 2", "line 8, in kernel"):
        assert place in ran.stderr
