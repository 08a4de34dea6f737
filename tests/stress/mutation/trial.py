"""Runs tests on a copy of the repository in which one module may be changed.

The worker imports what is slow and never changed, then every run is a fork of it: `eldir_hardware` and the
tests are imported there anew. A module is written into the copy, since processes that tests start import it
too.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import select
import shutil
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import pytest
from hypothesis import Phase, settings

from tests.paths import NODES, PACKAGES, ROOT

_LEFT_OUT = (".git", ".venv", ".*_cache", ".hypothesis", "__pycache__", "*.egg-info", "demo")
_SLOW = (
    "numpy", "scipy.optimize", "yaml", "pydantic", "typer.testing", "serial", "jsonschema",
    "pymodbus.server", "hypothesis.strategies", "mcap.reader", "rosbags.typesys",
    "eldir.built.heat", "eldir.built.gait_search", "eldir.design", "eldir_app.main",
)  # fmt: skip
_ADOPT_ORPHANS = 36  # PR_SET_CHILD_SUBREAPER
_PATIENCE = 5.0  # longer than its usual duration may a test take, and four times that [s]


class Ended(NamedTuple):
    """How a run of tests ended."""

    failed: str
    """The test that failed, hung, or could not be imported; empty where all passed."""
    how: str
    """failed | hung | import | passed"""


class Copy:
    """A copy of the repository, in which this process works from now on."""

    def __init__(self, root: Path, folder: Path):
        shutil.copytree(root, folder, ignore=shutil.ignore_patterns(*_LEFT_OUT), dirs_exist_ok=True)
        self.folder = folder
        self._written = 0
        ctypes.CDLL(None).prctl(_ADOPT_ORPHANS, 1, 0, 0, 0)
        os.chdir(folder)
        packages = [*(p.parent for p in PACKAGES.values()), NODES]
        homes = [str(folder / home.relative_to(ROOT)) for home in packages]
        sys.path[:] = [*homes, *(p for p in sys.path if p not in ("", str(root)))]
        os.environ["PYTHONPATH"] = os.pathsep.join(homes)
        for name in _SLOW:
            try:
                importlib.import_module(name)
            except ImportError:
                continue  # an extra that is not installed, or a module that has moved
        for name in [n for n in sys.modules if n.split(".")[0] in ("eldir_hardware", "tests")]:
            del sys.modules[name]

    def write(self, module: str, source: str) -> None:
        """Change a module. Its time of change is always another one: compiled files go by that."""
        path = self.folder / module
        path.write_text(source)
        self._written += 1
        os.utime(path, (self._written, self._written))

    def run(
        self,
        tests: Sequence[str],
        seconds: Mapping[str, float],
        plugin: object | None = None,
        failures: int = 1,
    ) -> Ended:
        """Run tests until so many have failed. `seconds`: how long each takes; without it none can hang."""
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(read)
            _run_tests(tests, write, plugin, failures)
        os.close(write)
        try:
            return _watch(child, read, seconds)
        finally:
            os.close(read)
            _end_orphans()


def _end_orphans() -> None:
    """End what the tests have left behind, such as a guardian of mutated code that never ends by itself."""
    children = Path(f"/proc/self/task/{os.getpid()}/children")
    while orphans := children.read_text().split():
        for orphan in map(int, orphans):
            with suppress(ProcessLookupError):
                os.kill(orphan, signal.SIGKILL)
            with suppress(ChildProcessError):
                os.waitpid(orphan, 0)


def _watch(child: int, read: int, seconds: Mapping[str, float]) -> Ended:
    current, text = "", b""
    deadline = float("inf") if not seconds else time.monotonic() + 60.0
    while True:
        ready, _, _ = select.select([read], [], [], min(1.0, max(0.0, deadline - time.monotonic())))
        if ready:
            chunk = os.read(read, 65536)
            text += chunk
            if not chunk:
                break
            *lines, text = text.split(b"\n")
            if lines:
                current = lines[-1].decode()
                if seconds:
                    deadline = time.monotonic() + 4 * seconds.get(current, 0.0) + _PATIENCE
        elif time.monotonic() > deadline:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return Ended(current, "hung")
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if code == 0:
        return Ended("", "passed")
    if code in (4, 5):
        raise RuntimeError(f"pytest could not run the tests (exit status {code})")
    return Ended(current, "failed" if current else "import")


class _Order:
    """Runs the chosen tests in their order, and tells each one's name before it begins."""

    def __init__(self, tests: Sequence[str], write: int):
        self._tests, self._write = {t: i for i, t in enumerate(tests)}, write

    def pytest_collection(self) -> None:
        profile = settings(
            settings.default, database=None, derandomize=True, phases=[Phase.explicit, Phase.generate]
        )
        settings.register_profile("mutants", profile)
        settings.load_profile("mutants")

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        if any("::" in t for t in self._tests):
            items[:] = sorted(
                (i for i in items if i.nodeid in self._tests), key=lambda i: self._tests[i.nodeid]
            )

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        os.write(self._write, nodeid.encode() + b"\n")


def _run_tests(tests: Sequence[str], write: int, plugin: object | None, failures: int) -> None:
    """In the child; never returns."""
    code = 3
    try:
        os.setpgid(0, 0)
        for stream in (0, 1, 2):
            os.dup2(os.open(os.devnull, os.O_RDWR), stream)
        files = list(dict.fromkeys(t.split("::")[0] for t in tests))
        options = [
            f"--maxfail={failures}",
            "-q",
            "--tb=no",
            "--no-header",
            "-p",
            "no:cacheprovider",
            "-W",
            "ignore::pytest.PytestAssertRewriteWarning",  # hypothesis is imported already
        ]
        plugins = [_Order(tests, write), *([plugin] if plugin else [])]
        code = int(pytest.main([*options, *files], plugins=plugins))
    finally:
        os._exit(code)
