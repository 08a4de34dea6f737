"""`benchmarks/narrow.c`: compilers and engine see a processor with shorter vectors."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from eldir.core.installation import describe
from tests.paths import ROOT

SOURCE = ROOT / "benchmarks" / "narrow.c"
_SEEN = """
import ctypes, os, subprocess
from eldir.core.installation import describe
from eldir.engine.kernels.simd import has_wide_registers
print(" ".join(describe()["platform"]["vectors"]))
print(has_wide_registers())
words = ["cc", "-march=native", "-Q", "--help=target"]
options = subprocess.run(words, capture_output=True, text=True).stdout.splitlines()
print(next(line.split()[1] for line in options if line.split()[:1] == ["-march="]), flush=True)
try:
    ctypes.string_at(0)
except BaseException:
    pass
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if shutil.which("cc") is None or os.uname().machine != "x86_64":
        pytest.skip("it is made for x86-64, and needs a C compiler named cc")
    made = tmp_path_factory.mktemp("narrow") / "narrow.so"
    words = ["cc", "-O2", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-o", made, SOURCE, "-ldl"]
    subprocess.run(words, check=True)
    return made


def _run(library: Path, narrow: str, program: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "NARROW": narrow, "LD_PRELOAD": str(library)}
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if "cannot make cpuid fault" in done.stderr:
        pytest.skip("this processor or kernel cannot make cpuid fault")
    return done


@pytest.mark.parametrize(
    ("narrow", "vectors", "target"),
    [("avx2", ["sse4_2", "avx", "fma", "avx2"], "haswell"), ("avx", ["sse4_2", "avx"], "sandybridge")],
)
def test_all_see_the_same_processor(library: Path, narrow: str, vectors: list[str], target: str) -> None:
    """Also the record of a benchmark. And a true fault still ends a program."""
    if not set(vectors) <= set(describe()["platform"]["vectors"]):
        pytest.skip(f"this processor has no {narrow}")
    done = _run(library, narrow, _SEEN)
    assert done.stdout.splitlines() == [" ".join(vectors), "False", target], done.stderr
    assert done.returncode == -11


def test_a_misspelt_width_is_told(library: Path) -> None:
    done = _run(library, "avx3", "print('ran')")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "narrow: NARROW is avx3; expected avx2 or avx\n"
