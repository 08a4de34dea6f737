"""The training's configuration: defaults, faults that are named, and files in which the scene held it."""

import json

import jsonschema
import pytest

from eldir.errors import InputError
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.run_folder import RunFolder
from eldir.scene import TRAINING_FIELDS, Scene
from eldir.training.configuration import TrainingConfig
from eldir.training.randomisation import Randomisation
from tests.paths import DATA, SCHEMAS
from tests.raised import raises

OLD = DATA / "old"
SCHEMA = json.loads((SCHEMAS / "run.schema.json").read_text())


def test_defaults_are_the_papers_and_those_of_the_preset():
    assert TrainingConfig() == TrainingConfig("steps", 0.2, 0.5) == TrainingConfig.of(Scene())
    assert TrainingConfig("adam").update_length == 2.0
    assert TrainingConfig.of(Scene.preset("released-rss")) == TrainingConfig()
    released = Scene.preset("released-main").replace(steps=10)
    assert TrainingConfig.of(released) == TrainingConfig(jump_threshold=1.0)
    assert EvolutionConfig(scene=released).training.jump_threshold == 1.0


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("optimiser", "sgd", "steps.*adam"),
        ("update_length", 0.0, "0"),
        ("update_length", float("inf"), "finite"),
        ("jump_threshold", -1.0, "0"),
    ],
)
def test_wrong_values_are_named(name, value, expected):
    with raises(InputError, "training.wrong-value", name, match=f"expected .*{expected}.*found"):
        TrainingConfig(**{name: value})


@pytest.mark.parametrize("name", sorted(TRAINING_FIELDS))
def test_a_scene_names_the_new_place_of_what_it_held(name):
    with raises(InputError, "scene.training-field", match=rf"TrainingConfig\({name}"):
        Scene().replace(**{name: 1.0})


def test_a_run_of_an_older_version_means_the_same():
    values = json.loads((OLD / "run.json").read_text())
    config = RunFolder.open(OLD).config
    assert config.training == TrainingConfig("adam", 2.0, 0.5)
    assert config.randomisation == Randomisation.unfilmed()
    assert config.scene == Scene()
    jsonschema.validate(values | {"config": config.to_json()}, SCHEMA)
    assert EvolutionConfig.from_json(config.to_json()) == config
    older = values["config"] | {"scene": dict(values["config"]["scene"]) | {"jump_threshold": 0.3}}
    for name in ("optimiser", "window"):  # fields that files from before lack
        del older["scene"][name]
    del older["doubt"]
    config = EvolutionConfig.from_json(older)
    assert config.training == TrainingConfig("steps", 2.0, 0.3) and config.randomisation is None
