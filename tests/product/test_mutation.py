"""The mutation tester: which changes it makes, what it leaves alone, and which tests it chooses."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests.paths import ROOT
from tests.stress.mutation.campaign import MODULES, TESTS
from tests.stress.mutation.explained import Explained, read_entries
from tests.stress.mutation.mutants import mutants
from tests.stress.mutation.selection import Selection, noting

SOURCE = '''"""A module."""
from __future__ import annotations
LIMIT: float = 0.5  # [s]
EDGE = 1e-6

def longest(values: list[float], most: int = 3) -> float | None:
    """The longest of the values."""
    if not values and most:
        raise ValueError("no values at all", values[0] + 1)
    try:
        best = min(values) - LIMIT
    except TypeError:
        return None
    for value in values:
        if value <= best:
            continue
        print(f"{value + 1}")
    return sorted(values, key=abs)[0]
'''


def test_the_changes_of_a_module():
    found = [(m.line, m.before, m.after) for m in mutants("a.py", SOURCE)]
    raised = "raise ValueError('no values at all', values[0] + 1)"
    assert found == [
        (3, "0.5", "1.0"),
        (4, "1e-06", "0.0"),
        (6, "3", "4"),
        (8, "not values and most", "most"),
        (8, "not values and most", "not values"),
        (8, "not values", "values"),
        (9, raised, "pass"),
        (11, "min(values) - LIMIT", "min(values) + LIMIT"),
        (11, "min(values)", "max(values)"),
        (12, "except TypeError:", "raise"),
        (15, "value <= best", "value < best"),
        (15, "value <= best", "value > best"),
        (16, "continue", "break"),
        (17, "print(f'{value + 1}')", "pass"),
        (18, "return sorted(values, key=abs)[0]", "return None"),
        (18, "sorted(values, key=abs)", "list(values, key=abs)"),
        (18, "sorted(values, key=abs)", "sorted(values)"),
        (18, "0", "1"),
    ]


def test_every_mutant_is_a_module_and_differs():
    listed = mutants("a.py", SOURCE)
    assert len({m.key for m in listed}) == len(listed) == len({m.source for m in listed})
    for mutant in listed:
        compile(mutant.source, "a.py", "exec")
    assert mutants("a.py", SOURCE) == listed


def test_a_module_notes_which_statements_run(tmp_path: Path):
    notes = tmp_path / "notes"
    space: dict = {}
    exec(noting("a.py", SOURCE, notes), space)
    assert not notes.exists(), "imports are not noted"
    space["longest"]([2.0, 1.0])
    space["longest"]([2.0, 1.0])
    assert sorted(notes.read_text().split()) == [f"a.py:{n}" for n in (10, 11, 14, 15, 17, 18, 7, 8)]


def test_the_tests_that_can_notice_a_mutant(tmp_path: Path):
    selection = Selection()
    selection.add("slow", 2.0, ["a.py:8", "a.py:11"])
    selection.add("quick", 0.1, ["a.py:8", "a.py:10", "a.py:11", "a.py:15"])
    selection.add("other", 0.1, ["b.py:1"])
    selection.save(tmp_path / "selection.json")
    selection = Selection.load(tmp_path / "selection.json")
    chosen = {}
    for mutant in mutants("a.py", SOURCE):
        chosen[mutant.line] = selection.of(mutant, {"a.py": SOURCE}, 10.0)
    assert chosen[15] == ["quick"] and chosen[8] == chosen[11] == ["quick", "slow"]
    assert chosen[3] == ["quick", "slow"], "a constant: those that run a statement with its name"
    assert chosen[6] == ["quick", "slow"] and chosen[9] == [] and chosen[18] == []
    first = next(m for m in mutants("a.py", SOURCE) if m.line == 8)
    assert selection.of(first, {"a.py": SOURCE}, 1.0) == ["quick"]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a.py: {longest: [{before: x, after: y, equivalent: no}]}", "no such mutant any more"),
        (
            "a.py: {longest: [{before: continue, after: break, equivalent: a}, "
            "{before: continue, after: break, accepted: b}]}",
            "explained twice",
        ),
    ],
)
def test_an_explanation_names_one_mutant(tmp_path: Path, text: str, told: str):
    path = tmp_path / "explained.yaml"
    path.write_text(text)
    with pytest.raises(ValueError, match=told):
        Explained(mutants("a.py", SOURCE), path)
    path.write_text("a.py: {longest: [{before: continue, after: break, equivalent: a}]}\nother.py: {x: []}")
    assert list(Explained(mutants("a.py", SOURCE), path).equivalent.values()) == ["a"]


def test_a_module_stands_once(tmp_path: Path):
    """YAML itself would take the last one and forget the others."""
    path = tmp_path / "explained.yaml"
    path.write_text("a.py: {x: []}\nb.py: {x: []}\na.py: {y: []}\n")
    with pytest.raises(yaml.YAMLError, match="duplicate name"):
        read_entries(path)


def test_what_is_listed_is_there():
    """Every explained mutant, and every file that is put under mutation or runs on it."""
    explained = read_entries()
    listed = [m for name in explained for m in mutants(name, (ROOT / name).read_text(), written=False)]
    Explained(listed)  # raises for a mutant that is not there any more
    assert set(explained) == {m.module for m in listed}
    assert all(any(ROOT.joinpath(name) in ROOT.glob(pattern) for pattern in MODULES) for name in explained)
    assert [pattern for pattern in (*MODULES, *TESTS) if not any(ROOT.glob(pattern))] == []


def test_tests_run_in_a_copy_of_the_repository(tmp_path: Path) -> None:
    """They see its modules, and their warnings are errors there too."""
    code = (
        "from pathlib import Path; from tests.paths import ROOT\n"
        "from tests.stress.mutation.trial import Copy\n"
        f"copy = Copy(ROOT, Path({str(tmp_path / 'copy')!r}))\n"
        "print(copy.run(['tests/hardware/test_clocks.py'], {}).how)\n"
        "copy.write('hardware/eldir_hardware/clock.py', 'raise RuntimeError')\n"
        "print(copy.run(['tests/hardware/test_clocks.py'], {}).how)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["passed", "import"]
