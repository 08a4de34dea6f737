"""The rooms of the code: none is crowded, each says what lives there, and tests do not lean on each other.

Which room may import which is held by the import contracts in pyproject.toml (`make lint`).
"""

import ast
import re
import runpy
import sys
from collections import Counter

import grimp

from tests.paths import NODES, PACKAGES, ROOT

MOST = 15
FOLDERS = [*PACKAGES.values(), NODES / "eldir_ros"]
FILES = [path for folder in FOLDERS for path in sorted(folder.rglob("*.py"))]
COMMANDS = PACKAGES["eldir_app"] / "commands"  # a module a sub-command


def test_no_folder_has_more_modules_than_one_can_survey() -> None:
    crowded = Counter(path.parent for path in FILES if path.name != "__init__.py" and path.parent != COMMANDS)
    assert {str(folder): n for folder, n in crowded.items() if n > MOST} == {}


def test_every_room_says_what_lives_there_and_what_does_not() -> None:
    for path in FILES:
        if path.name == "__init__.py":
            said = ast.get_docstring(ast.parse(path.read_text())) or ""
            assert len([line for line in said.splitlines() if line.strip()]) >= 2, path


def test_a_name_that_the_spelling_list_proposes_exists() -> None:
    """`make lint` refuses a name that was given up, and proposes the present one."""
    words = set(re.findall(r"\w+", "".join(path.read_text() for path in FILES)))
    entries = (ROOT / ".ci" / "words.txt").read_text().split()
    assert [entry for entry in entries if entry.partition("->")[2] not in words] == []


def test_a_module_is_on_the_python_pages_or_its_name_begins_with_an_underscore(monkeypatch) -> None:
    """In every room that has a public module."""
    monkeypatch.setattr(sys, "path", [str(ROOT / "docs" / "site"), *sys.path])
    public = runpy.run_path(str(ROOT / "docs" / "site" / "python_pages.py"))["MODULES"]
    modules = {
        ".".join((top, *path.relative_to(folder).with_suffix("").parts))
        for top, folder in PACKAGES.items()
        for path in folder.rglob("*.py")
    }
    assert set(public) <= modules
    rooms = {module.rpartition(".")[0] for module in public}
    neighbours = {module for module in modules if module.rpartition(".")[0] in rooms}
    assert sorted(m for m in neighbours - set(public) if not m.rpartition(".")[2].startswith("_")) == []


def test_imports_between_what_stands_side_by_side_in_eldir_are_half_of_what_they_were() -> None:
    """55 modules had 296 imports between them (docs/decisions/0029-rooms.md)."""
    graph = grimp.build_graph("eldir", cache_dir=None)

    def place(module: str) -> str:
        return ".".join(module.split(".")[:2])

    arrows = {
        (place(module), place(found))
        for module in graph.modules
        for found in graph.find_modules_directly_imported_by(module)
        if module != "eldir" and found != "eldir" and place(module) != place(found)
    }
    assert len(arrows) <= 148


def test_no_test_module_imports_another() -> None:
    imports = re.compile(r"^\s*(?:from|import)\s+([\w.]+)", re.MULTILINE)
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        for name in imports.findall(path.read_text()):
            assert not name.split(".")[-1].startswith("test_"), f"{path}: {name}"
