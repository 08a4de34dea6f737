"""The unchanged code under all tests, once: which test runs which statements, and how long it takes."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from tests.stress.mutation.selection import Selection, noting
from tests.stress.mutation.trial import Copy

_FLAKY = 3
"""So many tests may fail on the unchanged code, as on a busy machine; they are left out."""


def measure(copy: Copy, sources: Mapping[str, str], tests: Sequence[str], selection: Selection) -> None:
    """Run files of tests on modules that note their statements, and add what they run to the selection.

    Raises `RuntimeError` where they fail.
    """
    notes, results = copy.folder / "notes", copy.folder / "results"
    notes.touch()
    for module, source in sources.items():
        copy.write(module, noting(module, source, notes))
    ended = copy.run(tests, {}, _Notes(notes, results), failures=_FLAKY + 1)
    for module, source in sources.items():
        copy.write(module, source)
    failed = []
    for line in results.read_text().splitlines():
        one = json.loads(line)
        if one["skipped"]:
            continue
        if one["passed"]:
            selection.add(one["test"], one["seconds"], one["notes"])
        else:
            failed.append(one["test"])
    if failed:
        print("left out, as they fail on the unchanged code:", *failed, file=sys.stderr)
    if len(failed) > _FLAKY or not selection.tests:
        raise RuntimeError(f"the tests do not pass on the unchanged code: {failed or ended}")


class _Notes:
    """Collects after each test what the modules have noted."""

    def __init__(self, notes: Path, results: Path):
        self._notes, self._results = notes, results
        self._read, self._seconds, self._passed, self._skipped = 0, 0.0, True, False

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self._seconds, self._passed, self._skipped = 0.0, True, False
        for module in list(sys.modules.values()):
            if isinstance(noted := getattr(module, "_noted", None), set):
                noted.clear()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._seconds += report.duration
        self._passed = self._passed and report.passed
        self._skipped = self._skipped or report.skipped

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        data = self._notes.read_bytes()[self._read :] if self._notes.exists() else b""
        self._read += len(data)
        one = {
            "test": nodeid,
            "seconds": round(self._seconds, 4),
            "passed": self._passed,
            "skipped": self._skipped,
            "notes": sorted(set(data.decode().split())),
        }
        with self._results.open("a") as file:
            file.write(json.dumps(one) + "\n")
