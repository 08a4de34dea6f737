"""A packet of a robot on a terrain: its files, lists and pages, none of which a robot on a table has."""

from __future__ import annotations

import csv
import json
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path

import jsonschema
import pytest
import trimesh

from eldir.design import Design
from eldir.evolution.paper.configuration import make_terrain
from eldir.parameters.printed import BuiltParameters
from eldir.terrain import TerrainFile
from eldir_app.commands.packet import packet as command
from tests.cad.drawn_bodies import WHEEL, design
from tests.paths import SCHEMAS

TERRAIN = make_terrain("level", 3).scaled(BuiltParameters().scale)
ROBOT = design(*WHEEL)
ON_GROUND = replace(ROBOT, printed_terrain=TERRAIN)


def written(folder: Path, robot: Design) -> Path:
    """A packet as the command writes it; beside it is what it said."""
    robot.save(folder / "design.json")
    with (folder / "said").open("w") as said, redirect_stdout(said):
        command(folder / "design.json", folder / "packet")
    return folder / "packet"


@pytest.fixture(scope="module")
def packet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("ground"), ON_GROUND)


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("table"), ROBOT)


def test_the_packet_holds_the_terrain_and_its_pieces(packet: Path) -> None:
    file = TerrainFile.load(packet / "ground" / "terrain.json")
    assert file.robot == "printed" and file.terrain == TERRAIN
    assert Design.load(packet / "design.json").printed_terrain == TERRAIN
    manifest = json.loads((packet / "manifest.json").read_text())
    jsonschema.validate(manifest, json.loads((SCHEMAS / "packet-manifest.schema.json").read_text()))
    pieces = manifest["ground"]
    assert len(pieces) > 1
    with (packet / "bom.csv").open() as file_of_parts:
        rows = {row["part"]: row for row in csv.DictReader(file_of_parts)}
    end = None
    for name, piece in pieces.items():
        mesh = trimesh.load(packet / "ground" / f"{name}.stl")
        assert mesh.is_watertight and mesh.volume == pytest.approx(piece["volume_mm3"], rel=1e-4)
        assert piece["weight_g"] == pytest.approx(1.15e-3 * piece["volume_mm3"], rel=1e-4)
        assert end is None or piece["start_mm"] == end
        end = piece["end_mm"]
        assert rows[name]["weight_g"] == f"{piece['weight_g']:.3f}"
    plates = sorted((packet / "plates").glob("ground_plate_*.3mf"))
    assert plates and all(f"plates/{plate.name}" in manifest["files"] for plate in plates)


def test_the_robot_s_own_lists_and_parts_are_as_on_a_table(packet: Path, table: Path) -> None:
    """Files of the robot have the same bytes; the manifest's totals are the robot's."""
    assert not (table / "ground").exists()
    names = {p.relative_to(table) for p in table.rglob("*") if p.is_file()}
    differing = {str(n) for n in names if (table / n).read_bytes() != (packet / n).read_bytes()}
    assert differing == {
        "design.json",
        "bom.csv",
        "manifest.json",
        *(f"{n}.pdf" for n in ("assembly", "kit", "traveller")),
    }
    own, other = (json.loads((p / "manifest.json").read_text()) for p in (packet, table))
    assert own["totals"] == other["totals"] and own["parts"] == other["parts"]
    assert "ground" not in other


def test_the_pages_say_how_the_pieces_lie(packet: Path, table: Path) -> None:
    pages = [
        path.read_bytes().count(b"/Type /Page ") for path in (packet / "assembly.pdf", table / "assembly.pdf")
    ]
    assert pages[0] == pages[1] + 1 > 1


def test_the_command_says_what_the_ground_weighs(packet: Path) -> None:
    pieces = json.loads((packet / "manifest.json").read_text())["ground"]
    weight = sum(piece["weight_g"] for piece in pieces.values())
    said = packet.with_name("said").read_text()
    assert f"ground: {len(pieces)} pieces, {weight:.0f} g of resin" in said
