"""Scene files: those of format 1 still give the same robots, and what is written is described."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from eldir.built.gait import Gait
from eldir.built.samples import IdentifiedRobots, sample_walks
from eldir.built.scene import PrintedScene
from eldir.design import Design
from eldir.errors import InputError
from tests.calibration.dynamics.hidden_rigs import walker
from tests.paths import ROOT
from tests.raised import raises

OLD = ROOT / "tests" / "data" / "built-scene-1.json"
SCHEMA = json.loads((ROOT / "docs" / "schemas" / "built-scene.schema.json").read_text())
WALKED = Gait(20.0, np.array([0.0, 0.875]), np.array([0.3, 0.3]))
BALLAST = np.array([0.009] + [0.0] * 10)
INCONSISTENT = "built-scene.inconsistent"


def design_of(body: str, ballast: np.ndarray = BALLAST) -> Design:
    """Stands for a design of the walker."""
    values = {"body": body, "ballast": ballast, "morphology": walker().morphology, "printed_terrain": None}
    return type("Stand", (), values)()


def test_a_file_of_format_1_gives_the_robots_it_gave(monkeypatch: pytest.MonkeyPatch) -> None:
    """The file and the walks are of version 0.1.0, before the format changed; its feet were all alike."""
    monkeypatch.setattr("eldir.parameters.robot.FOOT_SPREAD", 0.0)
    scene, design = PrintedScene.load(OLD), design_of("0123456789ab")
    assert scene.parameters == ("hot_length", "cold_length", "friction") and scene.model_fits
    assert scene.z.tolist() == [-0.000674731, -0.00304448, -0.0825632]
    assert [s.hot_length for s in scene.robot.motor_springs(2)] == [0.0759433, 0.0740534]
    assert scene.robot.strips[:4].tolist() == [4.70876e-05, -4.26306e-05, 0.0, 2.79164e-06]
    assert scene.results.model.at_edge == () == scene.results.model.tried[0].at_edge
    (film,) = scene.filmed_of(design)
    assert (film.gait, film.walked, film.upright, film.log) == (WALKED, 0.31, True, "log.mcap")
    robots = IdentifiedRobots.of(design, scene, [film.gait])
    (walks,) = sample_walks(robots, [WALKED], 3, 5)
    before = [-0.005502036820125717, -0.005378421133791828, -0.0058492852212311585]
    assert walks.displacement == pytest.approx(before, abs=1e-9)


def test_springs_of_every_sample_get_longer_when_they_are_heated() -> None:
    """Also where films leave both lengths unknown, twice as wide as the priors; others are as drawn."""
    scene, design = PrintedScene.load(OLD), design_of("0123456789ab")
    names, wide = ("hot_length", "cold_length"), 4.0 * np.eye(2)
    robots = replace(IdentifiedRobots.of(design, scene), parameters=names, covariance=wide)
    samples = robots.samples(200, 1)
    drawn = [
        scene.robot.at(names, 2.0 * np.random.default_rng([1, i]).standard_normal(2)) for i in range(200)
    ]
    possible = [one.has_stroke(2) for one in drawn]
    assert 100 < sum(possible) < 190 and all(one.has_stroke(2) for one in samples)
    lengths = np.array([[one.free_lengths for one in some] for some in (samples, drawn)])
    assert np.array_equal(lengths[0, possible], lengths[1, possible])
    impossible = next(one for one, has in zip(drawn, possible, strict=True) if not has)
    cold, hot = impossible.free_lengths
    assert hot > cold, "a fit may ask for it"
    assert np.isfinite(sample_walks(robots, [WALKED], 8, 1, cycles=1)[0].displacement).any()


def test_a_file_of_format_1_is_written_as_the_present_one(tmp_path: Path) -> None:
    scene = PrintedScene.load(OLD)
    scene.save(tmp_path / "scene.json")
    written = json.loads((tmp_path / "scene.json").read_text())
    assert written["format"] == "eldir-built-scene/2"
    jsonschema.validate(written, SCHEMA)
    again = PrintedScene.load(tmp_path / "scene.json")
    assert again == scene
    again.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "scene.json").read_bytes()


def test_a_file_of_format_2_is_read_and_written_as_it_is(tmp_path: Path) -> None:
    """The file was written by the last version that wrote its entries one by one."""
    old = ROOT / "tests" / "data" / "old" / "built-scene-2.json"
    scene = PrintedScene.load(old)
    assert scene.results.model.parts and scene.results.model.fits and scene.results.evaluations > 0
    springs = scene.robot.motor_springs(2)
    assert [s.hot_length for s in springs] == pytest.approx(scene.results.motor_springs["hot_length"])
    scene.save(tmp_path / "scene.json")
    assert (tmp_path / "scene.json").read_bytes() == old.read_bytes()


def test_results_of_a_version_before_0_1_0_are_left_out(tmp_path: Path) -> None:
    values = json.loads(OLD.read_text())
    values["results"] = {"turns": values["results"]["turns"], "model": {"fits": False}}
    (tmp_path / "scene.json").write_text(json.dumps(values))
    scene = PrintedScene.load(tmp_path / "scene.json")
    assert scene.results is None and not scene.model_fits and scene.z[2] == -0.0825632


def test_single_parts_belong_to_the_filmed_body_alone() -> None:
    scene = PrintedScene.load(OLD)
    other = design_of("ba9876543210")
    assert scene.robot_of(other) == scene.robot.uniform and not scene.robot_of(other).has_individual_parts
    assert scene.filmed_of(other) == [] == scene.filmed_of(design_of("0123456789ab", 0 * BALLAST))


@pytest.mark.parametrize(
    ("damage", "code", "key"),
    [
        ({"parameters": ["hot_length", "wait", "friction"]}, INCONSISTENT, "parameters"),
        ({"z": [0.0]}, INCONSISTENT, "z"),
        ({"covariance": [[1.0, 2.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]}, INCONSISTENT, "covariance"),
        ({"format": "eldir-built-scene/3"}, "file.other-format", None),
    ],
)
def test_what_is_wrong_with_a_file_is_named(tmp_path: Path, damage: dict, code: str, key: str | None) -> None:
    path = tmp_path / "scene.json"
    PrintedScene.load(OLD).save(path)
    path.write_text(json.dumps(json.loads(path.read_text()) | damage))
    with raises(InputError, code, key):
        PrintedScene.load(path)


@pytest.mark.parametrize(
    ("entry", "value", "key", "said"),
    [
        ("covariance", 1e300, "covariance", "expected numbers from -900 to 900"),
        ("z", -31.0, "z", "expected numbers from -30 to 30"),
        ("built", 1e200, "tension", "found 1e\\+200"),
        ("built", 1e-200, "tension", "found 1e-200"),
        ("springs", 1e200, "wire_diameter", "found 1e\\+200"),
        ("springs_z", 1e200, "springs_z", "expected numbers from -30 to 30"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_numbers_out_of_all_measure_are_refused_in_one_line(
    entry: str, value: float, key: str, said: str, tmp_path: Path
) -> None:
    """Squared or exponentiated they overflowed, with warnings of NumPy or a traceback, in eldir gait."""
    values = json.loads(json.dumps(PrintedScene.load(OLD).to_json()))
    match entry:
        case "covariance":
            values[entry][0][0] = value
        case "z":
            values[entry][0] = value
        case "built":
            values[entry]["tension"] = value
        case "springs":
            values[entry]["wire_diameter"] = value
        case _:
            values["parts"]["springs_z"]["cold_length"][0] = value
    (tmp_path / "scene.json").write_text(json.dumps(values))
    with raises(InputError, INCONSISTENT, key, match=said):
        PrintedScene.load(tmp_path / "scene.json")
