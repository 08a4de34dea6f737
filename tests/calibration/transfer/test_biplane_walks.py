"""Walks in MuJoCo with both faces: how a robot turns and leans, and what `eldir transfer` says of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from eldir.built.gait import Gait, free_lengths, heat_faces
from eldir.errors import EldirError
from eldir.parameters.springs import SpringParameters
from eldir_app.application import application
from eldir_cad.kit.printer import load_printer
from eldir_cad.kit.specification import load_specification
from eldir_cad.multibody.biplane import build_biplane
from eldir_cad.multibody.model import Numerics
from eldir_calibration.transfer import biplane_walks
from eldir_calibration.transfer.biplane_walks import measure_biplane_walk, yaw_and_roll
from eldir_calibration.transfer.mujoco_walks import sample_face_springs, sample_heating
from eldir_calibration.transfer.page import TransferNumbers
from tests.calibration.transfer.made_up_walks import GAIT, tiny_design, written_gait
from tests.paths import SCHEMAS

pytest.importorskip("mujoco")  # installed with the extra `test`
SHORT = Gait(1.0, GAIT.phase, np.full(2, 0.5))
DESIGN = tiny_design(written_gait(SHORT))
BODY = DESIGN.morphology
NOMINAL = build_biplane(BODY, load_specification(), load_printer("xip"))


def test_yaw_and_lean_are_those_of_the_body_as_a_whole() -> None:
    rng = np.random.default_rng(1)
    rest = rng.normal(size=(12, 3)) * [0.1, 0.02, 0.1]
    angles = np.radians(rng.uniform(-60, 60, (20, 3)))
    angles[:, 0] *= 2.5
    # Yaw first, then the lean about the robot's own direction, then its rotation in the plane.
    turned = Rotation.from_euler("ZXY", angles).as_matrix()
    points = rest @ turned.swapaxes(1, 2) * 1.1 + rng.normal(size=(20, 1, 3))
    yaw, roll = yaw_and_roll(rest, points)
    assert yaw == pytest.approx(angles[:, 0]) and roll == pytest.approx(angles[:, 1])


def test_a_robot_that_falls_over_sideways_does_not_walk() -> None:
    """A table so steep that it falls to the back at once."""
    plane = NOMINAL.plane
    grips = [replace(face, friction=np.full(len(plane.hubs), 5.0)) for face in NOMINAL.faces]
    steep = replace(NOMINAL, front=grips[0], back=grips[1], side_tilt=np.radians(60))
    springs = SpringParameters()
    table = free_lengths(Gait(1.0, np.repeat(SHORT.phase, 2), np.repeat(SHORT.duty, 2)), springs, 1)
    table = replace(table, lengths=table.lengths[:61], first_cycle=20)
    found = measure_biplane_walk(steep, BODY, table, 1, springs)
    assert found.fault == "falls sideways" and found.displacement == -np.inf and found.roll > np.radians(45)


def test_a_simulation_that_fails_has_no_angles(monkeypatch: pytest.MonkeyPatch) -> None:
    def blown(*_: object) -> None:
        raise EldirError("the virtual robot's body blew up")

    monkeypatch.setattr(biplane_walks.BiplaneMotion, "follow", blown)
    table = free_lengths(Gait(1.0, np.repeat(SHORT.phase, 2), np.repeat(SHORT.duty, 2)), cycles=1)
    found = measure_biplane_walk(NOMINAL, BODY, table, 1, SpringParameters())
    assert found.fault == "fails" and np.isnan(found.roll)


def test_each_coil_is_heated_as_its_spring_says() -> None:
    springs = SpringParameters(neighbour_conductance=0.02)
    own = sample_face_springs(2, 1, springs)
    found = heat_faces(GAIT, own, 1, BODY.motor_hubs).lengths
    for face in (0, 1):
        alone = free_lengths(GAIT, own[face::2], 1, hubs=BODY.motor_hubs).lengths
        assert np.array_equal(found[:, face::2], alone)
    means = sample_heating(GAIT, 1, springs, 1, BODY.motor_hubs).lengths
    assert means == pytest.approx((found[:, ::2] + found[:, 1::2]) / 2)


def test_transfer_lets_robots_leave_their_plane_and_tells_how_they_turn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(biplane_walks, "FINE_NUMERICS", Numerics(step=5e-4, contact_time=1e-3))
    DESIGN.save(tmp_path / "tiny.json")
    told = CliRunner().invoke(
        application("transfer"),
        ["transfer", str(tmp_path / "tiny.json"), "--samples", "2", "--cycles", "1",
         "--out", str(tmp_path / "out")],
    )  # fmt: skip
    assert told.exit_code == 0, told.output
    values = json.loads((tmp_path / "out" / "transfer.json").read_text())
    jsonschema.validate(values, json.loads((SCHEMAS / "transfer.schema.json").read_text()))
    assert values["settings"]["dimensions"] == 3
    there = values["walks"][0]["mujoco"]
    assert [set(one) for one in there["in_space"]] == [{"yaw_deg", "roll_deg", "drift"}] * 2
    page = (tmp_path / "out" / "transfer.html").read_text()
    roll = max(one["roll_deg"] for one in there["in_space"])
    assert f"<td>{roll:.0f}°</td>" in page and roll > 0.1
    again = TransferNumbers.load(tmp_path / "out" / "transfer.json")
    assert again.walks[0].mujoco.in_space[1].roll_deg == there["in_space"][1]["roll_deg"]
