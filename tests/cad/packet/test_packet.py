"""A whole packet: every file, its bytes twice, plates read by other programs, parts that fit together."""

import csv
import hashlib
import json
import subprocess
import sys
import zipfile
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import trimesh
import typer
from lxml import etree
from matplotlib.image import imread

from eldir.design import Design, marked_masses
from eldir.errors import EldirError, InputError
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import develop
from eldir.parameters.springs import SpringParameters
from eldir_app.commands.packet import packet as command
from eldir_cad.geometry.assembly import assemble, smallest_gap, spring_directions
from eldir_cad.geometry.plates import nest
from eldir_cad.kit.printer import fit_to_printer, load_printer
from eldir_cad.kit.specification import load_specification
from eldir_cad.packet.folder import write_packet
from tests.cad.drawn_bodies import WHEEL, body, design
from tests.cad.written_packet import ROBOT, written_packet
from tests.paths import SCHEMAS
from tests.raised import raises

SCHEMA = SCHEMAS / "packet-manifest.schema.json"
PRINTER = load_printer()
SPEC = fit_to_printer(load_specification(), PRINTER)
CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"


@pytest.fixture(scope="module")
def packet(tmp_path_factory):
    return written_packet(tmp_path_factory)


@pytest.fixture(scope="module")
def manifest(packet):
    return json.loads((packet / "manifest.json").read_text())


def table(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def items_of(path):
    """Names and transforms of everything on a plate, read without our code."""
    with zipfile.ZipFile(path) as archive:
        model = etree.fromstring(archive.read("3D/3dmodel.model"))
    assert model.get("unit") == "millimeter"
    names = {o.get("id"): o.get("name") for o in model.iter(f"{CORE}object")}
    return [
        (names[i.get("objectid")], np.array(i.get("transform").split(), float).reshape(4, 3))
        for i in model.iter(f"{CORE}item")
    ]


def test_manifest_names_every_file_and_fits_its_schema(packet, manifest):
    rules = json.loads(SCHEMA.read_text())
    jsonschema.Draft202012Validator.check_schema(rules)
    jsonschema.validate(manifest, rules)
    files = {p.relative_to(packet).as_posix(): p for p in packet.rglob("*") if p.is_file()}
    del files["manifest.json"]
    assert manifest["files"] == {n: hashlib.sha256(p.read_bytes()).hexdigest() for n, p in files.items()}
    loose = {
        "bom.csv",
        "wiring.csv",
        "traveller.pdf",
        "assembly.pdf",
        "assembly.html",
        "kit.pdf",
        "markers.pdf",
        "preview.png",
        "preview.glb",
    }
    assert {n for n in files if "/" not in n} == loose | {"design.json", "tags.json"}
    assert {n.split("/")[0] + "/*" + Path(n).suffix for n in files if "/" in n} == {
        "plates/*.3mf", "plates/*.stl", "parts/*.stl"
    }  # fmt: skip
    assert all(files[name].stat().st_size > 100 for name in loose)
    assert Design.load(files["design.json"]) == ROBOT


def test_every_stl_is_watertight_and_weighs_what_the_manifest_says(packet, manifest):
    paths = sorted((packet / "parts").glob("*.stl"))
    assert {p.stem for p in paths} == set(manifest["parts"])
    for path in paths:
        mesh = trimesh.load(path)
        entry = manifest["parts"][path.stem]
        assert mesh.is_watertight and mesh.volume > 0, path.name
        assert mesh.volume == pytest.approx(entry["volume_mm3"], rel=1e-4)
        assert entry["weight_g"] == pytest.approx(mesh.volume * 1.15e-3, rel=1e-3)
    total = sum(e["count"] * e["volume_mm3"] for e in manifest["parts"].values())
    assert manifest["totals"]["volume_mm3"] == pytest.approx(total, rel=1e-6)
    figures = manifest["build_report"]["figures"]
    assert figures["resin_mm3"] == pytest.approx(total, rel=2e-4)
    coils = 2 * ROBOT.morphology.motors * 1e3 * SpringParameters().mass
    assert figures["robot_g"] == pytest.approx(manifest["totals"]["weight_g"] + coils, abs=0.02)
    assert figures["parts"] == manifest["totals"]["parts"]


def test_counts_follow_from_the_body(manifest):
    found = ROBOT.morphology
    count = {name: entry["count"] for name, entry in manifest["parts"].items()}
    degree = np.bincount(found.springs.ravel())
    assert count["passive_spring"] == 2 * (len(found.springs) - 2)
    assert count["spring_end"] == 2 * 2 * 2
    assert count["connector"] == (degree < 6).sum()
    assert count["cap"] == 2 * (degree == 6).sum()
    assert sum(n for name, n in count.items() if name.startswith("mass")) == 2 * len(degree)


def test_plates_hold_every_part_once_inside_the_printer_apart(packet, manifest):
    found: dict[str, int] = {}
    for path in sorted((packet / "plates").glob("*.3mf")):
        boxes = []
        for name, matrix in items_of(path):
            found[name] = found.get(name, 0) + 1
            corners = trimesh.load(packet / "parts" / f"{name}.stl").vertices @ matrix[:3] + matrix[3]
            boxes.append([corners.min(axis=0), corners.max(axis=0)])
        low, high = np.array(boxes).transpose(1, 0, 2)
        assert (low >= [2.99, 2.99, -1e-4]).all() and (high <= [192.01, 112.01, 210]).all()
        apart = np.maximum(low[:, None] - high[None], low[None] - high[:, None])[..., :2].max(axis=-1)
        assert apart[~np.eye(len(low), dtype=bool)].min() >= PRINTER.spacing - 1e-3
    assert found == {name: entry["count"] for name, entry in manifest["parts"].items()}


def test_plates_read_back_with_trimesh(packet):
    for path in (packet / "plates").glob("*.3mf"):
        scene = trimesh.load(path)
        whole = trimesh.load(path.with_suffix(".stl"))
        np.testing.assert_allclose(scene.bounds, whole.bounds, atol=1e-3)
        assert scene.volume == pytest.approx(whole.volume, rel=1e-4)
        assert all(g.is_watertight for g in scene.geometry.values())


def test_identical_input_gives_identical_bytes(packet, tmp_path):
    """In another process, with other hash seeds."""
    ROBOT.save(tmp_path / "design.json")
    code = (
        "import sys; from pathlib import Path; from eldir_app.commands.packet import packet;"
        "packet(Path(sys.argv[1]), Path(sys.argv[2]))"
    )
    again = tmp_path / "again"
    subprocess.run([sys.executable, "-c", code, tmp_path / "design.json", again], check=True, timeout=120)
    first, second = (
        {p.relative_to(root): p.read_bytes() for p in root.rglob("*") if p.is_file()}
        for root in (packet, again)
    )
    assert first.keys() == second.keys()
    assert [name for name in first if first[name] != second[name]] == []


def test_the_model_is_the_robot(packet, manifest):
    """Read back with trimesh: every part in its place, in metres."""
    scene = trimesh.load(packet / "preview.glb")
    assert len(scene.graph.nodes_geometry) == manifest["totals"]["parts"] + 2 * 2 * 12  # coils in pieces
    made = assemble(ROBOT.morphology, SPEC)
    centres = 1e-3 * made.centres
    low, high = scene.bounds
    corner = 1e-3 * SPEC.mass.across_flats / np.sqrt(3)
    assert low[:2] == pytest.approx(centres.min(axis=0) - corner, abs=1e-3)
    assert high[:2] == pytest.approx(centres.max(axis=0) + corner, abs=1e-3)
    assert high[2] == pytest.approx(1e-3 * (SPEC.connector.gap / 2 + SPEC.mass.height), abs=1e-6)


def test_what_was_measured_is_told(manifest, packet):
    for name, part in manifest["parts"].items():
        assert part["wall_mm"] >= PRINTER.minimum.wall - 1e-3, name
        assert part["gap_mm"] is None or part["gap_mm"] >= PRINTER.minimum.gap, name
    assert manifest["parts"]["connector"]["supports"] == "155 mm2 from below, at 4, 37.3 mm"
    assert manifest["parts"]["passive_spring"]["supports"] == "none"
    rows = {r["part"]: r for r in table(packet / "bom.csv")}
    assert rows["connector"]["supports"] == manifest["parts"]["connector"]["supports"]
    assert all(r["printed"] for r in rows.values() if r["file"])
    assert manifest["clearance"]["tightest_mm"] == pytest.approx(SPEC.clearance, rel=0.02)
    assert manifest["totals"]["plates"] == manifest["build_report"]["figures"]["plates"]


def test_wiring_names_each_motor_of_each_face_once(packet):
    rows = table(packet / "wiring.csv")
    assert [(r["spring"], r["face"], r["relay_channel"]) for r in rows] == [
        ("0", "front", "1"), ("0", "back", "2"), ("1", "front", "3"), ("1", "back", "4")
    ]  # fmt: skip
    found = ROBOT.morphology
    ends = found.springs[found.active]
    assert [(int(r["mass_a"]), int(r["mass_b"])) for r in rows[::2]] == [tuple(e) for e in ends]
    assert all(r["resistance_ohm_measured"] == "" and float(r["current_limit_a"]) == 3.6 for r in rows)
    assert all("cut-off of 6.3 s; otherwise 0.7 A" in r["current_conditions"] for r in rows)
    top = 1e3 * np.ptp(found.positions[:, 1]) * SPEC.scale / 1e3
    assert all(100 < int(r["lead_to_top_mm"]) < 110 + 1.2 * top for r in rows)


@pytest.mark.parametrize("seed", [*(pytest.param(n, marks=pytest.mark.stress) for n in (0, 1)), 2])
def test_placed_parts_keep_their_clearance(seed):
    lattice = Lattice(6, 11)
    found = develop(lattice, random_genotypes(lattice, 1, np.random.default_rng(seed), 2)[0])
    gap, one, other = smallest_gap(assemble(found, SPEC))
    assert gap == pytest.approx(SPEC.clearance, rel=0.01), (one, other)


def test_clearance_check_finds_parts_that_intersect():
    """Strips too thick for their sockets, put in by hand past the specification's own check."""
    thick = SPEC.model_copy(update={"strip": SPEC.strip.model_copy(update={"thickness": 2.2})})
    loose = assemble(body(*WHEEL), SPEC)
    forced = assemble(body(*WHEEL), thick)
    parts = {**loose.parts, "passive_spring": forced.parts["passive_spring"]}
    gap, *names = smallest_gap(
        type(loose)(loose.morphology, loose.centres, loose.marks, parts, loose.placements)
    )
    assert gap == 0 and "passive_spring" in names


def test_both_planes_are_identical():
    made = assemble(body(*WHEEL), SPEC)
    for front in (p for p in made.placements if p.face == "front"):
        name = front.part.replace("front", "back")
        twins = [
            p for p in made.placements if p.face == "back" and p.masses == front.masses and p.part == name
        ]
        assert len(twins) == 1
        meshes = []
        for place in (front, twins[0]):
            mesh = made.parts[place.part].mesh
            meshes.append(mesh.vertices @ place.rotation.T + place.translation)
        mirrored = meshes[0] * [1, 1, -1]
        np.testing.assert_allclose(mirrored.min(axis=0), meshes[1].min(axis=0), atol=1e-3)
        np.testing.assert_allclose(mirrored.max(axis=0), meshes[1].max(axis=0), atol=1e-3)


def test_spring_directions_of_the_hub_and_the_rim():
    wheel = body(*WHEEL)
    degree = np.bincount(wheel.springs.ravel())
    directions = spring_directions(wheel)
    assert directions[int(degree.argmax())] == [0, 1, 2, 3, 4, 5]
    assert directions[int(wheel.positions[:, 0].argmax())] == [2, 3, 4]


def test_marked_masses_have_seats(packet, manifest):
    marks = marked_masses(ROBOT.morphology)
    assert manifest["marks"] == {f"m{i + 1}": m for i, m in enumerate(marks.tolist())}
    purposes = {r["part"]: r["purpose"] for r in table(packet / "bom.csv")}
    seats = {name for name, purpose in purposes.items() if "seat for the disc" in purpose}
    assert seats == {f"mass_{m:02d}_front" for m in marks}, "where the camera looks"


def test_nothing_is_overwritten(packet):
    before = (packet / "manifest.json").read_bytes()
    with raises(EldirError, "file.exists"):
        write_packet(ROBOT, packet)
    assert (packet / "manifest.json").read_bytes() == before


@pytest.mark.parametrize("volume", [(60.0, 40.0, 30.0), (40.0, 40.0, 60.0)])
def test_a_part_larger_than_the_plate_leaves_nothing_behind(tmp_path, volume):
    small = PRINTER.model_copy(update={"volume": volume})
    with raises(InputError, "part.too-large"):
        write_packet(design(*WHEEL), tmp_path / "packet", printer=small)
    assert list(tmp_path.iterdir()) == []


def test_a_long_part_is_turned_to_fit():
    narrow = PRINTER.model_copy(update={"volume": (30.0, 115.0, 210.0)})
    made = assemble(body(*WHEEL), SPEC)
    plates = nest(made.parts, made.counts, narrow)
    assert sum(len(p.items) for p in plates) == sum(made.counts.values())
    assert all((p.mesh().bounds[1] <= [27.01, 112.01, 210]).all() for p in plates)


def test_the_preview_shows_something(packet):
    assert imread(packet / "preview.png").std() > 0.05


def test_the_command_says_the_manifest(packet, manifest):
    assert json.loads(packet.with_name("said").read_text()) == manifest


@pytest.mark.parametrize("wrong", [{"ballast": "heavy"}, {"ballast": "9g@99"}, {"printer": "makerbot"}])
def test_wrong_arguments_of_the_command(tmp_path, wrong):
    ROBOT.save(tmp_path / "design.json")
    with pytest.raises(typer.BadParameter, match="expected"):
        command(tmp_path / "design.json", tmp_path / "packet", **wrong)
    assert not (tmp_path / "packet").exists()


@pytest.mark.parametrize("text", [None, "", "{}", '{"format": "eldir-design/1"}', "solid cube"])
def test_designs_that_are_missing_or_damaged(tmp_path, text):
    path = tmp_path / "design.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=r"design\.json"):
        command(path, tmp_path / "packet")
    assert not (tmp_path / "packet").exists()
