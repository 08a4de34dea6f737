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
        ("numba", [], "invalid ELDIR_COMPILER; expected taichi or quadrants; found 'numba'"),
        ("quadrants", ["quadrants"], "asks for quadrants, which is not installed here"),
        (None, ["taichi", "quadrants"], "neither is installed here; pip install 'eldir[quadrants]'"),
    ],
)
def test_what_cannot_be_had_is_told_in_one_line(asked: str | None, missing: list[str], said: str) -> None:
    ran = python(MISSING.format(missing) + TOLD, asked)
    assert said in " ".join(ran.stdout.split()) and ran.stderr == ""


@pytest.mark.parametrize("compiler", ["taichi", "quadrants"])
def test_an_error_in_a_kernel_tells_where_it_stands(tmp_path: Path, compiler: str) -> None:
    """In the second use of a function too, and of another function that was made by the same lines. A kernel
    of the engine is translated once, which shows where Python runs while it is."""
    if find_spec(compiler) is None:
        pytest.skip(f"{compiler} is not installed here")
    (tmp_path / "kernel.py").write_text(
        "from eldir.engine import runtime\n"
        "from eldir.engine.compiler import new_kernel, ti\n"
        "def half_of(parts):\n"
        "    @ti.func\n"
        "    def half(x: ti.template()):\n"
        "        return x[0] / parts\n"
        "    return half\n"
        "half, whole = half_of(2), half_of(1)\n"
        "@ti.kernel\n"
        "def kernel(x: ti.types.ndarray()):\n"
        "    x[1] = half(x) + whole(x)\n"
        "@ti.kernel\n"
        "def wrong(x: ti.types.ndarray()):\n"
        "    first, second = half(x), whole(1.0)\n"
        "runtime.start()\n"
        "import numpy as np\n"
        "x = np.array([4.0, 0.0])\n"
        "kernel(x)\n"
        "assert x[1] == 6.0\n"
        "translations = []\n"
        "def note():\n"
        "    translations.append(len(translations))\n"
        "    return 7.0\n"
        "def noted(x: ti.types.ndarray()):\n"
        "    x[1] = ti.static(note()) + x[0]\n"
        "new_kernel(noted)(x)\n"
        "assert x[1] == 11.0 and translations == [0]\n"
        "wrong(x)\n"
    )
    ran = subprocess.run(
        [sys.executable, str(tmp_path / "kernel.py")],
        env=os.environ | {"ELDIR_COMPILER": compiler},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 1
    for place in ("line 6, in half", "return x[0] / parts", "line 14, in wrong"):
        assert place in ran.stderr, ran.stderr
