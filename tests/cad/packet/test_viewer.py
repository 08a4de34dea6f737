"""assembly.html: every part of the robot, with its number, in the step in which it is added, in one file."""

import base64
import io
import json
import re

import numpy as np
import pytest
import trimesh

from eldir.parameters.wiring import FACES, wiring
from eldir_cad.geometry.assembly import assemble
from eldir_cad.kit.printer import fit_to_printer, load_printer
from eldir_cad.kit.specification import load_specification
from eldir_cad.packet._viewer import assembly_page
from tests.cad.drawn_bodies import WHEEL, body

SPEC = fit_to_printer(load_specification(), load_printer())
MADE = assemble(body(*WHEEL, motors=(0, 4)), SPEC)


@pytest.fixture(scope="module")
def page():
    return assembly_page(MADE, SPEC, wiring(2))


def parts_of(page):
    return json.loads(re.search(r"const PARTS = (.*);\n", page).group(1))


def test_the_page_holds_the_robot_and_needs_no_other_file(page):
    data = base64.b64decode(re.search(r'base64_data="([^"]+)"', page).group(1))
    scene = trimesh.load(io.BytesIO(data), file_type="glb")
    parts = parts_of(page)
    assert set(parts) == set(scene.graph.nodes_geometry)
    assert len(parts) == len(MADE.placements) + 4
    assert np.ptp(scene.bounds, axis=0)[2] == pytest.approx(2e-3 * SPEC.outside, rel=1e-3), "in metres"
    assert not re.search(r"""(src|href)\s*=\s*["']?https?:""", page)
    assert page == assembly_page(MADE, SPEC, wiring(2)), "the same text"


def test_each_part_comes_in_its_step_and_says_where_it_is(page):
    steps = json.loads(re.search(r"const STEPS = (.*);\n", page).group(1))
    parts = parts_of(page).values()
    named = {step: [p["name"] for p in parts if p["step"] == step] for step in range(len(steps))}
    assert len(named[0]) == len(MADE.centres) and all("front face" in name for name in named[0])
    assert sum(map(len, named.values())) == len(parts)
    assert "mass 3, front face" in " ".join(named[0]) and "(mass_03_front.stl)" in " ".join(named[0])
    assert any(re.fullmatch(r"passive spring between masses \d and \d, front face .*", n) for n in named[1])
    coils = {motor: [n for n in named[2] + named[4] if f"motor S{motor}" in n] for motor in range(2)}
    assert [re.findall(r"channel (\d)", " ".join(names)) for names in coils.values()] == [
        ["1", "2"],
        ["3", "4"],
    ]
    assert all("connector" in name or "cap" in name for name in named[3])
    assert all(FACES[1] in name for name in named[4])


def test_springs_in_series_show_their_common_channel():
    names = [part["name"] for part in parts_of(assembly_page(MADE, SPEC, wiring(2, in_series=True))).values()]
    assert sum("channel 1" in name for name in names) == sum("channel 2" in name for name in names) == 2
