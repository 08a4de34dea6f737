"""Which tests can notice a mutant: those that run its statement, in whatever process.

Every statement of a module in a function gets a number, and a copy of the module notes in a file when one
runs for the first time. Statements outside of functions run at import: there every test that uses the
changed name can notice it.
"""

from __future__ import annotations

import ast
import json
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path

from tests.paths import ROOT
from tests.stress.mutation.mutants import Mutant

_NOTE = """
import os as _os
_noted = set()
def _note(line):
    try:
        here = _os.getpid(), line  # a forked program notes what it runs itself
    except AttributeError:  # MicroPython, which runs the firmware
        return
    if here not in _noted:
        _noted.add(here)
        try:  # opened anew, as a forked program has closed all files
            notes = _os.open({path!r}, _os.O_WRONLY | _os.O_APPEND | _os.O_CREAT, 0o666)
            _os.write(notes, b"{module}:%d\\n" % line)
            _os.close(notes)
        except OSError:
            pass
"""


def noting(module: str, source: str, path: Path) -> str:
    """The module's source that notes in the file `path` which lines begin a statement that has run."""
    tree = ast.parse(source)
    for body in _bodies(tree):
        for i in reversed(range(len(body))):
            body.insert(i, ast.parse(f"_note({body[i].lineno})").body[0])
    head = sum(1 for s in tree.body[:2] if isinstance(s, ast.Expr) or _future(s))  # behind the docstring
    tree.body[head:head] = ast.parse(_NOTE.format(path=str(path), module=module)).body
    return ast.unparse(ast.fix_missing_locations(tree))


def _future(node: ast.stmt) -> bool:
    return isinstance(node, ast.ImportFrom) and node.module == "__future__"


def _bodies(tree: ast.Module) -> Iterator[list[ast.stmt]]:
    """Every list of statements inside of functions."""
    for function in [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)]:
        for node in ast.walk(function):
            if isinstance(node, ast.FunctionDef) and node is not function:
                continue  # it comes by itself
            for _, value in ast.iter_fields(node):
                statements = isinstance(value, list) and value and isinstance(value[0], ast.stmt)
                if statements and not any(map(_is_noted, value)):
                    yield value


def _is_noted(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and ast.unparse(node).startswith("_note(")


@dataclass
class Selection:
    """Which tests run which statements, and how long they take."""

    seconds: dict[str, float] = field(default_factory=dict)
    """Duration of each test."""
    tests: dict[tuple[str, int], set[str]] = field(default_factory=lambda: defaultdict(set))
    """Tests by module and line."""

    _counts: Counter[str] = field(default_factory=Counter)
    digests: dict[str, str] = field(default_factory=dict)
    """Of each file of tests, with the code, when it was measured."""

    def changed(self, files: Sequence[str], sources: Mapping[str, str]) -> list[str]:
        """Forget the files of tests that are not as they were, and return those to measure."""
        shared = sha256("".join(sources.values()).encode())
        now = {f: sha256(shared.digest() + (ROOT / f).read_bytes()).hexdigest() for f in files}
        changed = [f for f in files if self.digests.get(f) != now[f]]
        self.digests = now
        gone = {t for t in self.seconds if t.split("::")[0] in changed or t.split("::")[0] not in files}
        for test in gone:
            del self.seconds[test]
        for users in self.tests.values():
            users.difference_update(gone)
        return changed

    def add(self, test: str, seconds: float, notes: Sequence[str]) -> None:
        """What a test has noted."""
        self.seconds[test] = seconds
        for note in notes:
            module, line = note.rsplit(":", 1)
            self.tests[module, int(line)].add(test)

    def save(self, path: Path) -> None:
        """For other processes."""
        tests = [[*place, sorted(tests)] for place, tests in self.tests.items()]
        path.write_text(json.dumps({"seconds": self.seconds, "tests": tests, "digests": self.digests}))

    @classmethod
    def load(cls, path: Path) -> Selection:
        """What `save` has written."""
        values = json.loads(path.read_text())
        tests = {(module, line): set(names) for module, line, names in values["tests"]}
        return cls(values["seconds"], defaultdict(set, tests), digests=values["digests"])

    def of(self, mutant: Mutant, sources: Mapping[str, str], most: float) -> list[str]:
        """The tests that can notice a mutant, of so many seconds together at most.

        Short ones first, and those that run little else.
        """
        found = self._by_line(mutant, sources)
        chosen, total = [], 0.0
        for test in sorted(found, key=lambda t: ((self.seconds[t] + 0.01) * self._breadth(t), t)):
            total += self.seconds[test]
            if total > most and chosen:
                break
            chosen.append(test)
        return chosen

    def _breadth(self, test: str) -> int:
        """How many statements a test runs."""
        if not self._counts:
            self._counts.update(t for tests in self.tests.values() for t in tests)
        return self._counts[test]

    def _by_line(self, mutant: Mutant, sources: Mapping[str, str]) -> set[str]:
        tree = ast.parse(sources[mutant.module])
        inside = [
            s for body in _bodies(tree) for s in body if s.lineno <= mutant.line <= (s.end_lineno or s.lineno)
        ]
        if inside:  # the smallest statement around it
            line = max(inside, key=lambda s: (s.lineno, -(s.end_lineno or 0))).lineno
            return self.tests[mutant.module, line]
        for node in ast.walk(tree):
            # A default of a parameter, or a decorator.
            if isinstance(node, ast.FunctionDef) and mutant.line in range(
                min([node.lineno, *(d.lineno for d in node.decorator_list)]), node.body[0].lineno
            ):
                return set().union(
                    *(self.tests[mutant.module, s.lineno] for s in ast.walk(node) if hasattr(s, "lineno"))
                )
        names = {
            name
            for s in ast.walk(tree)
            if isinstance(s, ast.Assign | ast.AnnAssign)
            and s.lineno <= mutant.line <= (s.end_lineno or s.lineno)
            for name in _stored(s)
        }
        users = {(m, line) for m, source in sources.items() for line in _users(source, names)}
        every = {t for (module, _), tests in self.tests.items() if module == mutant.module for t in tests}
        return set().union(*(self.tests[user] for user in users)) or every


def _stored(node: ast.Assign | ast.AnnAssign) -> Iterator[str]:
    for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
        for name in ast.walk(target):
            if isinstance(name, ast.Name):
                yield name.id


def _users(source: str, names: set[str]) -> Iterator[int]:
    """Lines of the statements in functions that mention a name, by itself, as an attribute or a default."""
    tree = ast.parse(source)
    for body in _bodies(tree):
        for statement in body:
            if _mentions(statement, names):
                yield statement.lineno
    for function in [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)]:
        if _mentions(function.args, names):
            yield from (s.lineno for s in function.body)


def _mentions(node: ast.AST, names: set[str]) -> bool:
    return any(getattr(n, "id", getattr(n, "attr", None)) in names for n in ast.walk(node))
