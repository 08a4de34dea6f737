"""All mutants of the modules that keep heat safe, each under the tests that can notice it."""

from __future__ import annotations

import multiprocessing
import random
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from tests.paths import ROOT
from tests.stress.mutation.baseline import measure
from tests.stress.mutation.explained import Explained
from tests.stress.mutation.mutants import Mutant, mutants
from tests.stress.mutation.results import Outcome, Results
from tests.stress.mutation.selection import Selection
from tests.stress.mutation.trial import Copy

MODULES = (
    "hardware/eldir_hardware/guardian/*.py",
    "hardware/eldir_hardware/relay/*.py",
    "hardware/eldir_hardware/safety/*.py",
    "hardware/eldir_hardware/schedule.py",
    "hardware/eldir_hardware/clock.py",
    "hardware/eldir_hardware/firmware/channel_limits.py",
    "hardware/eldir_hardware/firmware/protocol.py",
    "hardware/eldir_hardware/rig/board_identity.py",
    "hardware/eldir_hardware/rig/port_holder.py",
    "hardware/eldir_hardware/rig/supply.py",
    "hardware/eldir_hardware/rig/_board_hints.py",
    "hardware/eldir_hardware/run/player.py",
)
TESTS = (
    "tests/hardware/test_*.py",
    "tests/hardware/guardian/test_*.py",
    "tests/hardware/relay/test_*.py",
    "tests/hardware/rig/test_*.py",
    "tests/hardware/safety/test_*.py",
    "tests/hardware/sensor/test_*.py",
    "tests/app/commands/test_off.py",
    "tests/app/commands/test_rig_commands.py",
    "tests/hardware/firmware/test_mosfet_*.py",
    "tests/hardware/log/test_current_log.py",
    "tests/hardware/log/test_recover.py",
    "tests/hardware/planning/test_edges.py",
    "tests/hardware/run/test_faults.py",
    "tests/hardware/run/test_player.py",
    "tests/hardware/run/test_ready.py",
    "tests/hardware/virtual/test_virtual_rig.py",
)
LONGEST = 10.0
"""Tests of this duration together are run on a mutant that none of them notices [s]."""


class Campaign:
    """The mutants of the modules whose path contains one of the words."""

    def __init__(
        self,
        only: Sequence[str] = ("",),
        sample: int | None = None,
        seed: int = 1,
        measured: Path | None = None,
    ):
        """`measured`: file for what the tests run, so that only changed ones are measured again."""
        paths = sorted({p for pattern in MODULES for p in ROOT.glob(pattern)})
        self.sources = {str(p.relative_to(ROOT)): p.read_text() for p in paths}
        wanted = [m for m in self.sources if any(word in m for word in only)]
        self.mutants = [x for m in wanted for x in mutants(m, self.sources[m])]
        self.explained = Explained(self.mutants)
        if sample is not None and sample < len(self.mutants):
            chosen = sorted(random.Random(seed).sample(range(len(self.mutants)), sample))
            self.mutants = [self.mutants[i] for i in chosen]
        self.measured = measured and measured.resolve()  # workers change the folder
        self.tests = sorted(str(p.relative_to(ROOT)) for t in TESTS for p in ROOT.glob(t))

    def run(self, workers: int = 1, path: Path | None = None, *, equivalent_too: bool = False) -> Results:
        """Run all mutants. `path`: JSON file of the results; what was killed there is not run again."""
        results = Results(self.mutants, self.explained)
        before = results.load(path) if path is not None and path.exists() else set()
        left = [
            i
            for i, m in enumerate(self.mutants)
            if m.key not in before and (equivalent_too or m.key not in self.explained.equivalent)
        ]
        begun = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            for done, (i, outcome) in enumerate(self._outcomes(left, workers, Path(folder)), start=1):
                results.add(self.mutants[i], outcome)
                if path is not None:
                    results.save(path)
                if outcome.how in ("survived", "unused"):
                    print(outcome.how, self.mutants[i], file=sys.stderr)
                if done % 50 == 0:
                    minutes = (time.monotonic() - begun) / 60
                    print(f"{done} of {len(left)} in {minutes:.1f} min", file=sys.stderr, flush=True)
        return results

    def _outcomes(self, left: list[int], workers: int, folder: Path) -> Iterator[tuple[int, Outcome]]:
        """Results as they come, from processes with a copy each; the first of them measures the tests."""
        fork = multiprocessing.get_context("fork")
        todo, done = fork.SimpleQueue(), fork.SimpleQueue()
        measured = self.measured or folder / "selection.json"
        selection = Selection.load(measured) if measured.exists() else Selection()
        if changed := selection.changed(self.tests, self.sources):
            first = fork.Process(target=self._measure, args=(folder / "first", changed, selection, measured))
            first.start()
            first.join()
            if first.exitcode:
                raise RuntimeError("the tests do not pass on the unchanged code: see above")
            selection = Selection.load(measured)
        processes = [
            fork.Process(target=self._work, args=(folder / str(k), selection, todo, done), daemon=False)
            for k in range(workers)
        ]
        for process in processes:
            process.start()
        pending = iter(left)
        running = 0
        for _ in range(2 * workers):
            if (i := next(pending, None)) is not None:
                todo.put(i)
                running += 1
        while running:
            i, ended, *outcome = done.get()
            if i is None:
                raise RuntimeError(f"a worker failed: {ended}")
            yield i, Outcome(ended, *outcome)
            running -= 1
            if (i := next(pending, None)) is not None:
                todo.put(i)
                running += 1
        for _ in processes:
            todo.put(None)
        for process in processes:
            process.join()

    def _measure(self, folder: Path, changed: Sequence[str], selection: Selection, path: Path) -> None:
        measure(Copy(ROOT, folder), self.sources, changed, selection)
        selection.save(path)

    def _work(self, folder: Path, selection: Selection, todo, done) -> None:
        try:
            copy = Copy(ROOT, folder)
            while (i := todo.get()) is not None:
                done.put((i, *self._try(copy, selection, self.mutants[i])))
        except Exception as error:  # told to the process that waits
            done.put((None, repr(error)))
            raise

    def _try(self, copy: Copy, selection: Selection, mutant: Mutant) -> Outcome:
        tests = selection.of(mutant, self.sources, LONGEST)
        if not tests:
            return Outcome("unused", "", 0.0)
        begun = time.monotonic()
        copy.write(mutant.module, mutant.source)
        try:
            ended = copy.run(tests, selection.seconds)
        finally:
            copy.write(mutant.module, self.sources[mutant.module])
        how = "survived" if ended.how == "passed" else ended.how
        return Outcome(how, ended.failed, round(time.monotonic() - begun, 2))
