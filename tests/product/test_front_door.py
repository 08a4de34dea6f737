"""`import eldir`: every public name is there, and nothing heavy is loaded before it is used."""

import subprocess
import sys

import eldir


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
    assert "taichi" not in loaded("import eldir; eldir.built.build, eldir.built.drive, eldir.built.walk")


def test_every_public_name_is_there_and_lives_in_this_package() -> None:
    names = [
        name for name in dir(eldir) if name[0] != "_" and name not in ("annotations", "TYPE_CHECKING", "Any")
    ]
    assert {"Lattice", "random_genotypes", "develop", "learn", "simulate", "loss_and_gradient"} <= set(names)
    assert {"Scene", "Design", "evolve", "built"} <= set(names)
    for name in names:
        value = getattr(eldir, name)
        assert getattr(value, "__module__", getattr(value, "__name__", "")).startswith(
            ("eldir", "importlib")
        ), name
    for name in ("build", "drive", "walk"):
        assert callable(getattr(eldir.built, name))
    assert not hasattr(eldir, "no_such_name")
