"""The documentation says what is there: links lead somewhere, commands exist, schemas are schemas."""

import ast
import json
import pkgutil
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import typer

from eldir.built import walking
from eldir.errors import MissingDependencyError
from eldir.evolution.own.registration import GROUP as PROBLEMS
from eldir_app.application import GROUP, application
from tests.paths import NODES, PACKAGES, ROOT

FOLDERS = ("docs", "ros2_nodes", "benchmarks")
EVERY = [page for name in FOLDERS for page in (ROOT / name).rglob("*.md")]
PAGES = sorted([*ROOT.glob("*.md"), *(p for p in EVERY if "generated" not in p.parts)])  # by `make docs`
PYTHON = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
PYTHON_FILE = re.compile(r"`((?:[\w-]+/)*[\w-]+\.py)`")
DOTTED = re.compile(
    r"(?<![\w./-])((?:eldir(?:_cad|_hardware|_calibration|_app|_ros)?)(?:\.[A-Za-z_]\w*)+)(?!\.?[*\w])(?![(]?/)"
)
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
CALL = re.compile(r"(?:^ {4}|`)(?:\.venv/bin/)?eldir ((?:[a-z-]+)(?: [^`\n|]*)?)", re.MULTILINE)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", FENCE.sub("", page.read_text())):
        if not target.startswith(("http://", "https://", "#", "mailto:")):
            assert (page.parent / target.split("#")[0]).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_to_headings_lead_somewhere_on_a_forge_too(page: Path) -> None:
    """The site's own rule keeps dots and slashes as hyphens; a forge leaves them out."""
    for target in re.findall(r"\]\(([^)\s]*#[^)\s]+)\)", FENCE.sub("", page.read_text())):
        file, heading = target.split("#")
        other = page.parent / file if file else page
        if "://" not in target and other.suffix == ".md":
            assert heading in _anchors(other), target


@cache
def _everything() -> Any:
    """The command with all below it; making it takes as long as reading ten pages."""
    return typer.main.get_command(application())


def _anchors(page: Path) -> list[str]:
    """Targets of a page's headings as a forge makes them."""
    headings = re.findall(r"^#+ +(.+?)\s*$", FENCE.sub("", page.read_text()), re.MULTILINE)
    words = [re.sub(r"\]\([^)]*\)|[^\w\s-]", "", heading.lower()) for heading in headings]
    return [word.replace(" ", "-") for word in words]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_commands_that_pages_name_exist(page: Path) -> None:
    for line in CALL.findall(page.read_text()):
        command = _everything()
        words = line.split()
        while hasattr(command, "commands") and words and re.fullmatch("[a-z]+", words[0]):
            assert words[0] in command.commands, f"eldir {line}"
            command = command.commands[words.pop(0)]
        known = {name for p in command.params for name in p.opts} | {"--help"}
        for word in words:
            option = word.strip("[](),.;:").split("=")[0]
            if option.startswith("--"):
                assert option in known, f"eldir {line}"


NOT_INSTALLED = () if find_spec("torch") else ("import torch", "import eldir.torch")
"""PyTorch is in no extra, because everybody needs another build of it."""


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_what_pages_import_is_there(page: Path) -> None:
    for code in PYTHON.findall(page.read_text()):
        for statement in ast.parse(code).body:
            is_import = isinstance(statement, ast.Import | ast.ImportFrom)
            if is_import and ast.unparse(statement) not in NOT_INSTALLED:
                exec(compile(ast.Module([statement], []), str(page), "exec"), {})


@pytest.mark.parametrize("page", ["built", "python", "test-doubles"])
def test_examples_of_a_page_run(page: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """All Python of these reference pages, block after block; of a walk one cycle counts, not five."""
    monkeypatch.setattr(walking.walk, "__kwdefaults__", {"cycles": 1, "terrain": None})
    code = "\n".join(PYTHON.findall((ROOT / "docs" / "reference" / f"{page}.md").read_text()))
    exec(compile(code, page, "exec"), {})


@pytest.mark.parametrize("path", sorted((ROOT / "docs" / "schemas").glob("*.json")), ids=lambda p: p.name)
def test_schemas_are_schemas(path: Path) -> None:
    schema = json.loads(path.read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    assert schema.get("title")


@pytest.mark.parametrize("path", sorted((ROOT / "docs" / "schemas").glob("*.json")), ids=lambda p: p.name)
def test_every_property_of_a_schema_is_described(path: Path) -> None:
    """The site's page of the format has the descriptions as its column "meaning"."""
    undescribed = [
        where for where, entry in properties(json.loads(path.read_text())) if not entry.get("description")
    ]
    assert undescribed == []


def test_schemas_are_those_of_the_records(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "docs" / "site")
    written = import_module("schemas")
    assert set(written.FORMATS) == {p.name.split(".")[0] for p in (ROOT / "docs" / "schemas").iterdir()}
    for name in written.FORMATS:
        text = (ROOT / "docs" / "schemas" / f"{name}.schema.json").read_text()
        assert text == written.schema_text(name), "run: python docs/site/schemas.py"


def properties(schema: object, above: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Every property in a schema, at any depth, with its path."""
    if isinstance(schema, list):
        for part in schema:
            yield from properties(part, above)
    elif isinstance(schema, dict):
        for keyword, part in schema.items():
            if keyword in ("properties", "patternProperties", "$defs"):
                for name, entry in part.items():
                    if keyword == "properties":
                        yield f"{above}.{name}", entry
                    yield from properties(entry, f"{above}.{name}")
            elif keyword not in ("default", "enum", "const", "examples", "required"):
                yield from properties(part, above)


def test_runs_and_designs_describe_the_same_scene() -> None:
    design, run = (
        json.loads((ROOT / "docs" / "schemas" / f"{name}.schema.json").read_text())
        for name in ("design", "run")
    )
    assert design["$defs"]["Scene"] == run["$defs"]["Scene"]


def test_the_readme_lists_every_command() -> None:
    listed = set(re.findall(r"^\| `eldir ([a-z]+)`", (ROOT / "README.md").read_text(), re.MULTILINE))
    assert listed == set(_everything().commands)


def test_every_page_is_listed() -> None:
    for folder in ("reference", "how-to", "explanation", "decisions"):
        pages = {p.name: p.read_text() for p in (ROOT / "docs" / folder).glob("*.md")}
        index = (ROOT / "docs" / "index.md").read_text() + "".join(pages.values())
        for name in pages:
            assert f"]({folder}/{name})" in index or f"]({name})" in index, name


def test_every_module_that_is_named_is_there() -> None:
    """Dotted names in code, messages, pages and settings. Decision records and the changelog are history."""
    groups = {
        GROUP,
        PROBLEMS,
        *tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"],
    }
    texts = [ROOT / "pyproject.toml", ROOT / "Makefile", NODES / "setup.py", NODES / "setup.cfg"]
    for folder in (*PACKAGES.values(), *(ROOT / n for n in ("ros2_nodes", "examples", "docs", "tests"))):
        texts += [
            p
            for p in folder.rglob("*")
            if p.suffix in (".py", ".md", ".yaml", ".json", ".html") and "generated" not in p.parts
        ]
    for path in [*texts, *ROOT.glob("*.md")]:
        if "decisions" not in path.parts and path.name != "CHANGELOG.md":
            for name in DOTTED.findall(path.read_text()):
                assert name in groups or is_there(name.split(".")), f"{path.relative_to(ROOT)}: {name}"


def test_every_python_file_that_a_page_names_is_there() -> None:
    """By the end of its path. Decision records and the changelog are history."""
    written_by_readers = {"my_boards/toy.py", "robot-run.py"}  # files that a reader or the program writes
    folders = (
        *PACKAGES.values(),
        *(ROOT / n for n in ("benchmarks", "docs", "examples", "ros2_nodes", "tests")),
    )
    there = [f"/{p.relative_to(ROOT)}" for folder in folders for p in folder.rglob("*.py")]
    assert f"/{Path(__file__).relative_to(ROOT)}" in there
    for page in [*(ROOT / "docs").rglob("*.md"), *ROOT.glob("*.md"), ROOT / "benchmarks" / "README.md"]:
        if "decisions" not in page.parts and page.name != "CHANGELOG.md":
            for name in PYTHON_FILE.findall(page.read_text()):
                known = name in written_by_readers or any(path.endswith(f"/{name}") for path in there)
                assert known, f"{page.relative_to(ROOT)}: {name}"


def is_there(words: list[str]) -> bool:
    """Whether the words are a module, perhaps followed by names that it has."""
    folder, rest = PACKAGES.get(words[0], NODES / words[0]), words[1:]
    while rest and (folder / rest[0]).is_dir():
        folder, rest = folder / rest[0], rest[1:]
    if not rest or ((folder / f"{rest[0]}.py").exists() and (len(rest) == 1 or words[0] == "eldir_ros")):
        return True
    try:
        pkgutil.resolve_name(".".join(words))
    except (ImportError, AttributeError):
        return False
    except MissingDependencyError:  # the module is there, and needs what is not installed here
        return True
    return True


def test_every_format_has_its_schema_and_every_schema_its_format() -> None:
    """But for what is inside Parquet, MCAP and 3MF files."""
    code = "".join(p.read_text() for folder in PACKAGES.values() for p in folder.rglob("*.py"))
    inside = {
        "generation", "part", "survivors", "printed-generation", "printed-archive", "log", "plate",
    }  # fmt: skip
    schemas = "".join(p.read_text() for p in (ROOT / "docs" / "schemas").glob("*.json"))
    described = newest_formats(schemas)
    written = {name: number for name, number in newest_formats(code).items() if name not in inside}
    assert written == {n: number for n, number in described.items() if not n.startswith("benchmark-")}


def newest_formats(text: str) -> dict[str, int]:
    """The highest number of each quoted "eldir-name/number"; code also names older ones that it reads."""
    found: dict[str, int] = {}
    for name, number in re.findall(r'"eldir-([a-z-]+)/([0-9]+)"', text):
        found[name] = max(int(number), found.get(name, 0))
    return found
