"""One version everywhere, and the files that tell how to cite, report and release."""

import re
import subprocess
from datetime import date
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

from eldir.core.version import __version__
from tests.paths import ROOT

CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text())
RELEASES = re.findall(r"^## ([0-9.]+) - ([0-9-]+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
PACKAGES = sorted((ROOT / "ros2_nodes").glob("*/package.xml"))
FORMS = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))


def test_the_newest_release_is_the_version() -> None:
    released = [version for version, _ in RELEASES]
    assert released[0] == __version__
    assert released == sorted(released, key=lambda v: [int(n) for n in v.split(".")], reverse=True)
    assert CITATION["version"] == __version__
    assert CITATION["date-released"] == date.fromisoformat(RELEASES[0][1])
    assert re.search(
        rf'^    version="{re.escape(__version__)}",$',
        (ROOT / "ros2_nodes/eldir_ros/setup.py").read_text(),
        re.MULTILINE,
    )


@pytest.mark.parametrize("path", PACKAGES, ids=lambda p: p.parent.name)
def test_the_nodes_have_the_same_version(path: Path) -> None:
    assert ElementTree.parse(path).findtext("version") == __version__
    logged = re.findall(
        r"^([0-9.]+) \(([0-9-]+)\)\n-+$", path.with_name("CHANGELOG.rst").read_text(), re.MULTILINE
    )
    assert logged[0] == RELEASES[0]


def test_the_tag_of_this_version_is_on_a_commit_that_names_it() -> None:
    """Where the tag is there: it is made after the commit, and a checkout may lack tags."""
    shown = subprocess.run(
        ["git", "show", f"v{__version__}:eldir/core/version.py"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if shown.returncode:
        pytest.skip(f"no tag v{__version__} here")
    assert f'__version__ = "{__version__}"' in shown.stdout


def test_the_citation_names_the_paper() -> None:
    """Its whole form was checked with cffconvert --validate."""
    assert CITATION["cff-version"] == "1.2.0" and CITATION["message"] and CITATION["authors"]
    (paper,) = CITATION["references"]
    assert paper["title"] == "Evolution and learning in differentiable robots" and paper["year"] == 2024
    assert [a["family-names"] for a in paper["authors"]] == ["Strgar", "Matthews", "Hummer", "Kriegman"]


@pytest.mark.parametrize("path", [p for p in FORMS if p.name != "config.yml"], ids=lambda p: p.stem)
def test_issue_forms_are_complete(path: Path) -> None:
    """A form with a mistake is not shown, and nobody is told."""
    form = yaml.safe_load(path.read_text())
    assert form["name"] and form["description"]
    kinds = {"markdown", "input", "textarea", "checkboxes"}
    named = [part["id"] for part in form["body"] if part["type"] != "markdown"]
    assert len(named) == len(set(named)) >= 1
    for part in form["body"]:
        assert part["type"] in kinds
        assert part["attributes"].get("value" if part["type"] == "markdown" else "label")
        assert set(part) <= {"type", "id", "attributes", "validations"}
    assert any(part.get("validations", {}).get("required") for part in form["body"])


def test_faults_and_rigs_come_with_the_output_of_info() -> None:
    for name in ("bug", "hardware"):
        form = yaml.safe_load((ROOT / ".github" / "ISSUE_TEMPLATE" / f"{name}.yml").read_text())
        (info,) = (part for part in form["body"] if part.get("id") == "info")
        assert info["validations"]["required"] and "eldir info" in info["attributes"]["label"]
