"""Parts: closed, in millimetres, with the volumes that geometry gives; specifications that cannot be."""

import io
import math

import jsonschema
import numpy as np
import pytest
import trimesh
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from eldir.errors import InputError
from eldir_cad.geometry import parts, shapes
from eldir_cad.kit.printer import fit_to_printer, load_printer
from eldir_cad.kit.specification import load_specification
from tests.paths import ROOT, SCHEMAS
from tests.raised import raises

DATA = ROOT / "cad" / "eldir_cad" / "kit" / "data"
PRINTER = load_printer()
SPEC = fit_to_printer(load_specification(), PRINTER)


def hexagon_area(across_flats):
    return math.sqrt(3) / 2 * across_flats**2


def plug_area(bulb, neck, reach, turn=0.0):
    """A disc, and a slot from its centre to `reach` beyond that flares by `turn` on either side [rad];
    what they share, a sector and two triangles, is taken off."""
    radius, half = bulb / 2, neck / 2
    slot = 2 * (half * reach + reach**2 * math.sin(turn) / 2) / math.cos(turn)
    meet = turn + math.asin(half / radius)
    inside = radius**2 * meet + radius * math.cos(meet) * half / math.cos(turn)
    return math.pi * radius**2 + slot - inside


def read_back(part):
    """The part as another program reads its STL."""
    return trimesh.load(io.BytesIO(shapes.stl(part.mesh)), file_type="stl")


MAKERS = {
    "strip": lambda: parts.strip(SPEC),
    "connector": lambda: parts.connector(SPEC),
    "cap": lambda: parts.cap(SPEC),
    "fitting": lambda: parts.fitting(SPEC),
    "end mass": lambda: parts.mass(SPEC, 0, [0], "front"),
    "full mass": lambda: parts.mass(SPEC, 86, range(6), "back", "m3"),
    "marked mass": lambda: parts.mass(SPEC, 107, [1, 2, 5], "front", "m1"),
}


@pytest.mark.parametrize("name", MAKERS)
def test_every_part_is_a_closed_solid_on_the_plate(name):
    part = MAKERS[name]()
    mesh = read_back(part)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0
    assert len(mesh.split()) == 1
    assert mesh.bounds[0, 2] == pytest.approx(0, abs=1e-6)
    assert mesh.volume == pytest.approx(part.volume, rel=1e-6)
    assert shapes.stl(part.mesh) == shapes.stl(part.mesh)


def test_45_mm_of_passive_spring_are_between_two_masses():
    strip = read_back(parts.strip(SPEC))
    np.testing.assert_allclose(strip.extents, [52, 2.4, 5], rtol=0.005)
    assert SPEC.pitch - SPEC.mass.across_flats == SPEC.free_strip == 45
    s = SPEC.strip
    half = s.length / 2 - s.bulb_diameter / 2
    area = 2 * plug_area(s.bulb_diameter, s.thickness, half)
    assert strip.volume == pytest.approx(area * s.height, rel=1e-3)


def test_volume_of_a_connector():
    c, gap = SPEC.connector, SPEC.clearance
    rise = c.gap - 2 * gap
    expected = (
        2 * c.peg_length * hexagon_area(c.peg)
        + 2 * c.flange_thickness * math.pi * c.flange_diameter**2 / 4
        + (rise - 2 * c.flange_thickness) * math.pi * c.column_diameter**2 / 4
    )
    made = read_back(parts.connector(SPEC))
    assert made.volume == pytest.approx(expected, rel=1e-3)
    assert made.extents[2] == pytest.approx(rise + 2 * c.peg_length)


def test_volume_of_a_cap():
    c = SPEC.connector
    expected = c.flange_thickness * math.pi * c.flange_diameter**2 / 4 + c.peg_length * hexagon_area(c.peg)
    assert read_back(parts.cap(SPEC)).volume == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("directions", [[0], [1, 4], [0, 1, 2, 3, 4, 5]])
@pytest.mark.parametrize("mark", [None, "m1"])
def test_volume_of_a_mass(directions, mark):
    m, s, gap = SPEC.mass, SPEC.strip, SPEC.clearance
    reach = m.across_flats / 2 - SPEC.bulb_radius_at
    turn = math.radians(s.turn_deg)
    socket = plug_area(s.bulb_diameter + 2 * gap, s.thickness + 2 * gap, reach, turn)
    engraved = shapes.number(1, m.digit_height, m.stroke, 1).area() * m.engraving_depth
    expected = (
        hexagon_area(m.across_flats) * m.height
        - (len(directions) * socket + hexagon_area(m.peg_hole)) * m.socket_depth
        - engraved
    )
    if mark:
        expected -= math.pi * m.disc_diameter**2 / 4 * m.disc_depth
    made = read_back(parts.mass(SPEC, 1, directions, "front", mark))
    assert made.volume == pytest.approx(expected, rel=1e-3)
    assert parts.mass_volume(SPEC, len(directions)) == pytest.approx(
        hexagon_area(m.across_flats) * m.height
        - (len(directions) * socket + hexagon_area(m.peg_hole)) * m.socket_depth,
        rel=1e-3,
    )


def test_the_engraved_number_has_the_area_of_its_bars():
    """A 1 is two bars of half a digit's height, joined; the line below is as wide as the digit."""
    height, stroke = 4.0, 0.6
    bars = stroke * (height + stroke)
    line = stroke * (height / 2 + stroke)
    assert shapes.number(1, height, stroke, 1).area() == pytest.approx(bars + line)
    assert shapes.number(1, height, stroke, 2).area() == pytest.approx(bars + 2 * line)


def test_the_faces_are_mirror_images():
    """Sockets open to the same directions of the body although the faces look at each other."""
    front = parts.mass(SPEC, 8, [1], "front").mesh
    back = parts.mass(SPEC, 8, [1], "back").mesh
    # The socket at +60 degrees takes volume from the upper right; the front is printed upside down.
    assert back.center_mass[0] < 0 and back.center_mass[1] < 0
    assert front.center_mass[0] < 0 and front.center_mass[1] > 0


@settings(max_examples=20, deadline=None)
@given(st.sets(st.integers(0, 5), min_size=1), st.integers(0, 199), st.sampled_from(parts.FACES))
def test_masses_of_any_directions_are_solids(directions, index, face):
    mesh = parts.mass(SPEC, index, sorted(directions), face).mesh
    assert mesh.is_watertight
    assert mesh.euler_number == 2


def changed(**changes):
    values = yaml.safe_load((DATA / "parts.yaml").read_text())
    for key, value in changes.items():
        section, _, name = key.partition("__")
        if name:
            values[section][name] = value
        else:
            values[key] = value
    return values


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"clearance": 0.75}, "clearance.*slips out"),
        ({"clearance": 0.2, "strip__height": 4.5}, "clearance.*peg"),
        ({"strip__length": 57.0}, "strip.length must be less than the pitch"),
        (
            {"clearance": 0.25, "strip__turn_deg": 29.0, "fitting__stand_off": 4.0},
            "turn_deg.*found 29 degrees",
        ),
        ({"fitting__stand_off": 0.5}, "stand_off.*clears its mass"),
        ({"mass__across_flats": 8.0}, "across_flats must be more than"),
        ({"mass__floor": 0.7}, "floor must be more than"),
        ({"strip__height": 5.2}, "strip.height must be at most"),
        ({"connector__gap": 3.0}, "connector.gap"),
        ({"coil__hot_length": 10.0}, "hot_length"),
        ({"pitch": -50.0}, "pitch"),
        ({"pitch": "wide"}, "pitch"),
        ({"clearance": float("nan")}, "'.nan' is not a finite number in line 1"),
        ({"colour": "blue"}, "colour"),
        ({"format": "eldir-printer/1"}, "format"),
    ],
)
def test_specifications_that_cannot_be(tmp_path, changes, message):
    path = tmp_path / "parts.yaml"
    path.write_text(yaml.safe_dump(changed(**changes)))
    with pytest.raises(InputError, match=message):
        load_specification(path)


@pytest.mark.parametrize("text", ["", "format: [", "- 1", "\x00", "format: eldir-specification/1"])
def test_damaged_specifications(tmp_path, text):
    path = tmp_path / "parts.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"parts\.yaml"):
        load_specification(path)


def test_missing_files_and_unknown_printers(tmp_path):
    with raises(InputError, "file.missing"):
        load_specification(tmp_path / "none.yaml")
    with raises(InputError, "input.unknown-name", "printer", match="expected xip"):
        load_printer("makerbot")
    with raises(InputError, "file.missing"):
        load_printer(str(tmp_path / "mine.yaml"))


@pytest.mark.parametrize(
    ("minimum", "message"),
    [
        ({"clearance": 0.4}, "clearance is below"),
        ({"wall": 1.15}, "strip.thickness|wall"),
        ({"pin": 3.0}, "connector.peg"),
        ({"hole": 2.0}, "wire_guide"),
    ],
)
def test_what_a_printer_cannot_print(minimum, message):
    coarse = PRINTER.model_copy(update={"minimum": PRINTER.minimum.model_copy(update=minimum)})
    with pytest.raises(InputError, match=message):
        fit_to_printer(load_specification(), coarse)


def test_the_printers_allowance_widens_sockets_only():
    tight = PRINTER.model_copy(update={"allowance": 0.05})
    spec = fit_to_printer(load_specification(), tight)
    assert spec.clearance == pytest.approx(0.15)
    # A slot's sides move apart and its floor goes down; so does the hole for a peg.
    assert parts.socket(spec).area() > parts.socket(SPEC).area()
    assert spec.mass.socket_depth - SPEC.mass.socket_depth == pytest.approx(0.1)
    assert spec.mass.peg_hole - SPEC.mass.peg_hole == pytest.approx(0.1)
    assert spec.mass.floor == SPEC.mass.floor
    assert parts.strip(spec).volume == parts.strip(SPEC).volume


@pytest.mark.parametrize(("name", "schema"), [("parts", "specification"), ("xip", "printer")])
def test_data_files_fit_their_schemas(name, schema):
    rules = yaml.safe_load((SCHEMAS / f"{schema}.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(rules)
    jsonschema.validate(yaml.safe_load((DATA / f"{name}.yaml").read_text()), rules)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({"format": "eldir-other/1"}, rules)
