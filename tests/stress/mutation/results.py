"""Outcomes of mutants: a JSON file, and a table for people."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from tests.stress.mutation.explained import Explained, Key
from tests.stress.mutation.mutants import Mutant

_SURVIVES = ("survived", "unused")


class Outcome(NamedTuple):
    """What became of a mutant."""

    how: str
    """failed, hung, import: a test noticed it; survived; unused: no test runs its statement."""
    test: str
    """The test that noticed it."""
    seconds: float


class Results:
    """Outcomes of a campaign."""

    def __init__(self, mutants: Iterable[Mutant], explained: Explained):
        self._mutants = list(mutants)
        self._explained = explained
        self._outcomes: dict[Key, Outcome] = {}
        self._others: list[dict[str, object]] = []

    def add(self, mutant: Mutant, outcome: Outcome) -> None:
        """Enter an outcome."""
        self._outcomes[mutant.key] = outcome

    def load(self, path: Path) -> set[Key]:
        """Take over from a file what was killed; return which mutants that were."""
        known = {m.key for m in self._mutants}
        for one in json.loads(path.read_text())["mutants"]:
            key = (one["module"], one["where"], one["before"], one["after"], one["number"])
            if key not in known:
                self._others.append(one)
            elif one["how"] not in _SURVIVES:
                self._outcomes[key] = Outcome(one["how"], one["test"], one["seconds"])
        return set(self._outcomes)

    def save(self, path: Path) -> None:
        """Write all outcomes in the order of the mutants, behind those of other modules in the file."""
        rows = list(self._others)
        for m in self._mutants:
            if m.key in self._outcomes:
                names = dict(zip(("module", "where", "before", "after", "number"), m.key, strict=True))
                rows.append(names | {"line": m.line} | self._outcomes[m.key]._asdict())
        new = path.with_suffix(".new")
        new.write_text(json.dumps({"mutants": rows}, indent=1) + "\n")
        new.replace(path)

    def _survives(self, mutant: Mutant) -> bool:
        outcome = self._outcomes.get(mutant.key)
        return outcome is not None and outcome.how in _SURVIVES

    @property
    def unexplained(self) -> list[Mutant]:
        """Those that survive without a reason."""
        reasons = self._explained.equivalent | self._explained.accepted
        return [m for m in self._mutants if self._survives(m) and m.key not in reasons]

    @property
    def wrongly_explained(self) -> list[Mutant]:
        """Those that a test noticed, although the list says that none does."""
        reasons = self._explained.equivalent | self._explained.accepted
        return [
            m for m in self._mutants if m.key in reasons and m.key in self._outcomes and not self._survives(m)
        ]

    @property
    def share(self) -> float:
        """Those that survive, explained or not, of all that were run and are not equivalent."""
        counted = [
            m for m in self._mutants if m.key in self._outcomes and m.key not in self._explained.equivalent
        ]
        return sum(map(self._survives, counted)) / max(1, len(counted))

    def table(self) -> str:
        """One row a module."""
        rows = [
            "| module | mutants | equivalent | run | killed | survived |",
            "| --- | --- | --- | --- | --- | --- |",
        ]
        modules = sorted({m.module for m in self._mutants})
        for module in [*modules, ""]:
            own = [m for m in self._mutants if module in ("", m.module)]
            equivalent = sum(m.key in self._explained.equivalent for m in own)
            survived = sum(self._survives(m) and m.key not in self._explained.equivalent for m in own)
            noticeable = [m for m in own if m.key not in self._explained.equivalent]
            killed = sum(m.key in self._outcomes and not self._survives(m) for m in noticeable)
            name = f"`{module}`" if module else "**all**"
            run = killed + survived
            rows.append(f"| {name} | {len(own)} | {equivalent} | {run} | {killed} | {survived} |")
        return "\n".join(rows) + "\n"

    def page(self) -> str:
        """The page in docs: the table, and every mutant that need not be noticed, with its reason."""
        parts = [_HEAD, self.table()]
        for title, reasons in (
            ("Accepted", self._explained.accepted),
            ("Equivalent", self._explained.equivalent),
        ):
            rows = [m for m in self._mutants if m.key in reasons]
            if rows:
                parts += ["", f"## {title}", "", "| where | change | reason |", "| --- | --- | --- |"]
                for m in rows:
                    change = f"`{m.before}` -> `{m.after}`".replace("|", "\\|")
                    name = f"`{Path(m.module).stem}`, {m.where.strip('<>')}"
                    parts.append(f"| {name} | {change} | {reasons[m.key]} |")
        return "\n".join(parts).rstrip() + "\n"


_HEAD = """# Mutants of the code that keeps heat safe

A mutant is a copy of the code with one small fault: a limit that is off by one, an inverted
condition, a doubled number, a statement or an argument left out. The tests must fail. `make stress`
runs all mutants with all tests that reach the changed code. It refuses more than 5 % survivors, and
any survivor that is not explained in `tests/stress/mutation/explained.yaml`. This page is written
by `python -m tests.stress.mutation --workers 2 --results mutants.json --table
docs/safety-mutants.md`.

- **Equivalent**: no test can detect the change; it is not run.
- **Run**: of what is not equivalent.
- **Killed**: a test failed, or took more than four times its usual time and five seconds more.
- **Survived**: no test fails; each is explained below under "Accepted".
"""
