"""Commands that predict with the kit's parts, for a robot of other parts."""

from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from eldir.design import Design
from eldir_app.application import application
from eldir_cad.kit.specification import load_specification
from eldir_cad.packet.folder import write_packet
from tests.cad.drawn_bodies import TRIANGLE, design

ROBOT = design(*TRIANGLE)


@pytest.mark.parametrize(
    "words",
    [
        ("gait", "--rig", "none.yaml", "--out", "schedule.json"),
        ("adapt", "--rig", "none.yaml", "--out", "adapted"),
        ("transfer", "--rig", "none.yaml", "--out", "transfer"),
        ("show", "--schedule", "none.json"),
        ("export", "--rig", "none.yaml", "--out", "robot.xml"),
        ("calibrate", "dynamics", "none.mcap", "--out", "scene.json", "--design"),
    ],
    ids=lambda words: words[0],
)
def test_a_command_that_predicts_warns_before_it_computes(
    words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for other_parts, warned in ((("pitch",), 1), ((), 0)):
        replace(ROBOT, other_parts=other_parts).save(tmp_path / "design.json")
        found = CliRunner().invoke(application(), [*words, "design.json"])
        assert found.stderr.count("warning: design.json: the parts are not the kit's (pitch)") == warned
        assert found.exit_code != 0, "what else it needs is missing"


def test_a_packet_of_other_parts_says_so_in_its_design(tmp_path: Path) -> None:
    kit = load_specification()
    thick = kit.model_copy(update={"strip": kit.strip.model_copy(update={"thickness": 1.2})})
    found = []
    for specification in (thick, kit):
        packet = write_packet(ROBOT, tmp_path / str(len(found)), specification)
        found.append(Design.load(packet.path / "design.json").other_parts)
    assert found == [("tension", "buckling", "bending", "strip"), ()]
