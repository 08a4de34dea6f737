"""`import eldir`: every public name is there, and nothing heavy is loaded before it is used."""

import re
import subprocess
import sys
from types import ModuleType

import numpy as np
import pytest

import eldir
import eldir.evolution
import eldir_hardware
from eldir.errors import InputError
from tests.paths import ROOT
from tests.raised import raises


def loaded(code: str) -> set[str]:
    """Modules that a fresh interpreter has loaded after `code`."""
    code += "; import sys; print(*sys.modules)"
    return set(
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout.split()
    )


def test_the_import_loads_nothing_heavy() -> None:
    heavy = {"taichi", "numpy", "scipy", "cv2", "trimesh", "matplotlib", "pyarrow", "pydantic"}
    assert not loaded("import eldir") & heavy
    assert "taichi" not in loaded(
        "import eldir; eldir.Lattice, eldir.Scene, eldir.learn, eldir.simulate, eldir.evolve"
    )
    assert not loaded("import eldir_hardware") & heavy
    assert "taichi" not in loaded("import eldir; eldir.built.build, eldir.built.drive, eldir.built.walk")


@pytest.mark.parametrize("package", [eldir, eldir.built, eldir.evolution, eldir_hardware])
def test_every_public_name_is_there_and_lives_in_this_package(package: ModuleType) -> None:
    for name in dir(package):
        value = getattr(package, name)
        assert getattr(value, "__module__", value.__name__).startswith("eldir"), name
    assert not hasattr(package, "no_such_name")


def test_the_star_brings_the_public_names_and_no_others() -> None:
    brought: dict[str, object] = {}
    exec("from eldir import *", brought)
    documented = set(
        re.findall(r"^\| `eldir\.(\w+)", (ROOT / "docs/reference/python.md").read_text(), re.MULTILINE)
    )
    documented |= {"EvolutionConfig", "Genotype", "Morphology"}  # named within the rows
    assert documented == set(brought) - {"__builtins__"} == set(eldir.__all__)


def test_wrong_arguments_are_named() -> None:
    lattice, rng = eldir.Lattice(4, 6), np.random.default_rng(1)
    scene = eldir.Scene.preset("paper").replace(steps=5)
    with raises(InputError, "input.wrong-value", "n"):
        eldir.random_genotypes(lattice, 0, rng)
    bodies = [eldir.develop(lattice, g) for g in eldir.random_genotypes(lattice, 2, rng, max_active=2)]
    trained = eldir.learn(bodies, scene, iterations=1).controllers
    with raises(InputError, "input.wrong-shape", "w1 of controller 0"):
        eldir.learn(bodies, scene, iterations=1, controllers=trained[::-1])
    robot = eldir.built.build(bodies[0])
    lengths = np.full((3, bodies[0].motors), 0.035)
    with raises(InputError, "input.wrong-value", "interval"):
        eldir.built.drive([robot], [lengths], 0.0)
    with raises(InputError, "input.wrong-value", "lengths of robot 0"):
        eldir.built.drive([robot], [lengths * np.nan], 0.1)
    with raises(
        InputError, "input.wrong-number", "tables of lengths", match="expected 1, one for each robot; found 2"
    ):
        eldir.built.drive([robot], [lengths] * 2, 0.1)
