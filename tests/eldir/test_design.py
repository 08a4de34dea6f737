"""Designs are saved and loaded whole, and what is wrong with a file is named."""

import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest

from eldir.core.files import new_folder, write_text
from eldir.design import Ballast, Design, Variant
from eldir.errors import EldirError, InputError
from eldir.scene import Scene
from eldir.terrain import Terrain
from eldir.training.configuration import TrainingConfig
from tests.eldir.random_design import make_design
from tests.paths import DATA, SCHEMAS
from tests.raised import raises

SCHEMA = SCHEMAS / "design.schema.json"
OLD = DATA / "old"


@pytest.mark.parametrize("seed", range(5))
def test_a_design_survives_its_file(tmp_path, seed):
    design = make_design(seed)
    path = tmp_path / "design.json"
    design.save(path)
    assert Design.load(path) == design
    first = path.read_bytes()
    Design.load(path).save(path)
    assert path.read_bytes() == first
    jsonschema.validate(json.loads(first), json.loads(SCHEMA.read_text()))


def test_a_variant_survives_its_file_and_is_checked(tmp_path):
    variant = Variant(1, Ballast(9.0, 3))
    design = replace(make_design(), variant=variant, kept_marks=(2, 0, 1))
    design.save(tmp_path / "design.json")
    values = json.loads((tmp_path / "design.json").read_text())
    jsonschema.validate(values, json.loads(SCHEMA.read_text()))
    assert values["variant"] == {"without_motor": 1, "ballast": {"grams": 9.0, "mass": 3}}
    assert values["marks"] == [2, 0, 1] and values["provenance"] == {"seed": 0}
    found = Design.load(tmp_path / "design.json")
    assert found == design != make_design()
    assert found.ballast[3] == found.ballast.sum() == pytest.approx(9e-3) and found.marks.tolist() == [
        2,
        0,
        1,
    ]
    with raises(InputError, "design.inconsistent", "variant.ballast"):
        replace(design, variant=Variant(ballast=Ballast(9.0, 999)))
    assert not {"variant", "marks"} & set(make_design().to_json())


def test_a_design_of_an_older_version_means_the_same():
    """The scene held the training then, and the provenance the variant and the marks."""
    values = json.loads((OLD / "design.json").read_text())
    was = values["provenance"]
    found = Design.load(OLD / "design.json")
    assert found.variant.to_json() == was["variant"] and found.variant.ballast is not None
    assert found.marks.tolist() == was["marks"]
    assert found.ballast[was["variant"]["ballast"]["mass"]] == found.ballast.sum() == pytest.approx(9e-3)
    training = TrainingConfig.from_json(found.provenance["training"])
    assert training == TrainingConfig("adam")
    assert found.scene == Scene.from_json(values["scene"])
    assert found.scene.window == 100
    again = json.loads(json.dumps(found.to_json()))
    jsonschema.validate(again, json.loads(SCHEMA.read_text()))
    assert Design.from_json(again) == found
    assert again["provenance"] == {
        **{k: v for k, v in was.items() if k not in ("variant", "marks")},
        "training": training.to_json(),
    }


def test_two_designs_differ():
    assert make_design(0) != make_design(1)


@pytest.mark.parametrize(
    ("damage", "code", "key"),
    [
        (lambda v: v.pop("genotype"), "design.missing-key", "genotype"),
        (lambda v: v.update(format="eldir-rig/1"), "file.other-format", None),
        (lambda v: v["genotype"].update(springs="01"), "design.inconsistent", "springs"),
        (
            lambda v: v["genotype"]["triangles"].__setitem__(0, "abc"),
            "design.inconsistent",
            "genotype.triangles",
        ),
        (lambda v: v["controller"].update(w1=[[1.0]]), "design.inconsistent", "controller.w1"),
        (lambda v: v["controller"].update(w2=[]), "design.inconsistent", "Controller.b2"),
        (lambda v: v["scene"].update(wind=3), "design.unknown-key", "scene.wind"),
        (lambda v: v["scene"].update(precision="f16"), "design.wrong-value", "scene.precision"),
    ],
)
def test_damaged_designs_are_named(tmp_path, damage, code, key):
    path = tmp_path / "design.json"
    values = make_design().to_json()
    damage(values)
    path.write_text(json.dumps(values))
    with raises(InputError, code, key):
        Design.load(path)


def test_missing_and_broken_files_are_named(tmp_path):
    with raises(InputError, "file.missing"):
        Design.load(tmp_path / "none.json")
    (tmp_path / "broken.json").write_text('{"format": "eldir-des')
    with raises(InputError, "file.damaged"):
        Design.load(tmp_path / "broken.json")
    with raises(InputError, "file.not-read"):
        Design.load(tmp_path)


def test_a_folder_is_written_whole_or_not_at_all(tmp_path):
    with pytest.raises(RuntimeError), new_folder(tmp_path / "a") as folder:
        write_text(folder / "x", "half")
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []
    with new_folder(tmp_path / "a") as folder:
        write_text(folder / "x", "whole")
    assert (tmp_path / "a" / "x").read_text() == "whole"
    with raises(EldirError, "file.exists"), new_folder(tmp_path / "a"):
        pass
    with raises(EldirError, "file.not-written"), new_folder(tmp_path / "a" / "x" / "y"):
        pass


def test_terrain_is_continuous_and_stays_in_bounds():
    for tilt in (-0.2, 0.0, 0.2):
        terrain = Terrain.rugged(np.random.default_rng(1), tilt)
        for i in range(1, len(terrain.x0)):
            x = terrain.x0[i]
            before = terrain.slope[i - 1] * x + terrain.intercept[i - 1]
            assert terrain.height(np.array([x]))[0] == pytest.approx(before)
        heights = terrain.height(np.linspace(-0.5, 2, 1000))
        assert heights.min() >= -1e-12
        assert heights.max() <= 0.5 + 1e-12
        assert terrain.height(np.array([-0.5]))[0] == (0.4 if tilt < 0 else 0.1)
    with pytest.raises(InputError):
        Terrain.from_segments([0, 0], [0, 0], [0, 0])
    with raises(InputError, "scene.inconsistent", "Scene.contact"):
        Scene(terrain=Terrain.rugged(np.random.default_rng(1)))


@pytest.mark.parametrize("tilt", [-0.49, -0.3, 0.3, 0.49])
def test_the_steepest_rugged_ground(tilt):
    for seed in range(20):
        terrain = Terrain.rugged(np.random.default_rng(seed), tilt)
        heights = terrain.height(terrain.x0)
        assert heights.min() > -1e-12 and heights.max() < 0.5 + 1e-12 and terrain.x0[-1] >= 1.25


@pytest.mark.parametrize("tilt", [0.6, 1.0, 30.0, -0.6, 0.4901, -0.4901, np.nan, np.inf])
def test_rugged_ground_that_no_draw_can_make(tilt):
    with raises(InputError, "input.wrong-value", "tilt", match=r"expected -0\.49 to 0\.49; found"):
        Terrain.rugged(np.random.default_rng(1), tilt)


class Stuck(np.random.Generator):
    """Every slope rises."""

    def uniform(self, low, high):
        return high


def test_drawing_rugged_ground_ends():
    with pytest.raises(InputError, match="no segment of rugged ground"):
        Terrain.rugged(Stuck(np.random.PCG64(1)))
