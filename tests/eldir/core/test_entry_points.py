"""What packages register: which of two counts, and one line for a package that cannot be used."""

import sys
from fractions import Fraction
from pathlib import Path

import pytest

from eldir.core.entry_points import load_registered, registered_names
from eldir.errors import InputError
from tests.raised import raises

GROUP = "things_of_tests"


def add_package(folder: Path, name: str, *lines: str) -> str:
    """A package as pip leaves it, whose metadata registers these; the folder to put on the path."""
    about = folder / name / f"{name}-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("\n".join([f"[{GROUP}]", *lines, ""]))
    return str(folder / name)


def test_the_first_package_on_the_path_counts_but_never_before_eldir(tmp_path, monkeypatch):
    one = add_package(tmp_path, "one", "half = fractions:Fraction", "scene = fractions:Fraction")
    # As another package of eldir would register it.
    other = add_package(tmp_path, "other", "half = decimal:Decimal", "scene = eldir.scene:Scene")
    for path, half in (([one, other], "fractions"), ([other, one], "decimal")):
        monkeypatch.setattr(sys, "path", [*path, *sys.path])
        assert registered_names(GROUP) == ("half", "scene")
        assert load_registered(GROUP, "half", "thing", type).__module__.lstrip("_") == half
        assert load_registered(GROUP, "scene", "thing", type).__module__ == "eldir.scene"
        monkeypatch.undo()


def test_what_is_registered_is_made(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(add_package(tmp_path, "one", "half = fractions:Fraction"))
    made = load_registered(GROUP, "half", "thing", Fraction, make=lambda found: found(1, 2))
    assert made == Fraction(1, 2)
    with raises(
        InputError, "package.broken", match=r"the thing half .*fractions:Fraction.*ZeroDivisionError"
    ):
        load_registered(GROUP, "half", "thing", Fraction, make=lambda found: found(1, 0))
    with raises(InputError, "package.broken", match=r"expected an object of the class fractions\.Fraction"):
        load_registered(GROUP, "half", "thing", Fraction)


@pytest.mark.parametrize("found", ["fractions:Nothing", "no_such_module:Thing"])
def test_a_package_that_lacks_it_is_named(found, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(add_package(tmp_path, "one", f"half = {found}"))
    with raises(InputError, "package.broken", match=f"cannot be loaded from {found}"):
        load_registered(GROUP, "half", "thing", Fraction)


def test_where_none_is_installed_it_says_so():
    with raises(InputError, "input.unknown-name", "thing", match="there is none"):
        load_registered(GROUP, "half", "thing", Fraction)
