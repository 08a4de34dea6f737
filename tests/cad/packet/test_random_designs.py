"""Random designs and specifications: either a clear error, or parts that are sound and fit together."""

import numpy as np
import pytest
import trimesh
from hypothesis import event, given, settings
from hypothesis import strategies as st

from eldir.errors import EldirError, InputError
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import develop
from eldir_cad.checks.buildability import check
from eldir_cad.checks.strip_law import StripLaw, built_parameters
from eldir_cad.geometry.assembly import assemble, smallest_gap
from eldir_cad.geometry.inspection import inspect, require_printable
from eldir_cad.kit.printer import fit_to_printer, load_printer
from eldir_cad.kit.specification import Specification, load_specification
from eldir_cad.packet.manifest import make_content
from tests.cad.drawn_bodies import HOURGLASS, RHOMBUS, TRIANGLE, WHEEL, body, design
from tests.raised import raises

PRINTER = load_printer()
SPEC = fit_to_printer(load_specification(), PRINTER)

LENGTHS = {
    ("pitch",): (52.0, 62.0),
    ("clearance",): (0.08, 0.2),
    ("mass", "across_flats"): (11.5, 14.0),
    ("mass", "floor"): (1.4, 3.0),
    ("mass", "peg_hole"): (2.6, 3.2),
    ("strip", "thickness"): (0.5, 1.4),
    ("strip", "bulb_diameter"): (2.1, 2.9),
    ("strip", "turn_deg"): (0.0, 18.0),
    ("connector", "gap"): (20.0, 50.0),
    ("fitting", "stand_off"): (1.2, 3.0),
    ("holder", "across_flats"): (14.5, 17.0),
}


@st.composite
def specifications(draw):
    """The kit's specification with some lengths drawn anew; not all of these can be."""
    values = load_specification().model_dump()
    changed = draw(st.sets(st.sampled_from(sorted(LENGTHS)), min_size=1, max_size=4))
    for path in sorted(changed):
        low, high = LENGTHS[path]
        section = values
        for key in path[:-1]:
            section = section[key]
        section[path[-1]] = round(draw(st.floats(low, high)), 2)
    return values


@settings(max_examples=30, deadline=None)
@given(specifications(), st.sampled_from([TRIANGLE, RHOMBUS, HOURGLASS, WHEEL]))
def test_a_specification_is_refused_or_gives_parts_that_fit(values, rows):
    try:
        spec = fit_to_printer(Specification.from_json(values), PRINTER)
    except InputError as error:
        assert "must be" in str(error) or "expected at least" in str(error)
        event("refused when read" if "must be" in str(error) else "refused for the printer")
        return
    made = assemble(body(*rows), spec)
    try:
        for part in made.parts.values():
            require_printable(part.name, part.mesh, inspect(part.mesh, PRINTER), PRINTER)
    except EldirError as error:
        assert "expected at least" in str(error)
        event("refused as measured")
        return
    event("made")
    gap, one, other = smallest_gap(made)
    assert gap == pytest.approx(spec.clearance, rel=0.03), (one, other)
    for part in made.parts.values():
        assert part.mesh.is_watertight and part.mesh.is_winding_consistent
        assert part.solid.volume() == pytest.approx(part.volume, rel=1e-5)
    law, scene = StripLaw.of(spec, PRINTER), built_parameters(spec, PRINTER)
    assert scene.buckling == pytest.approx(law.buckling, rel=1e-2)
    assert (scene.bending > 0) == (spec.strip.turn_deg == 0)


@settings(max_examples=3, deadline=None)
@given(st.integers(0, 10_000))
def test_random_designs_become_robots_that_fit_together(seed):
    lattice = Lattice(6, 11)
    found = develop(lattice, random_genotypes(lattice, 1, np.random.default_rng(seed), 2)[0])
    report = check(found, SPEC, PRINTER)
    made = assemble(found, SPEC, disc_faces=("front",))
    gap, one, other = smallest_gap(made)
    assert gap == pytest.approx(SPEC.clearance, rel=0.02), (one, other)
    assert report.figures["parts"] == sum(made.counts.values())
    assert report.figures["resin_mm3"] == pytest.approx(made.volume, rel=2e-4)
    for name in list(made.parts)[:4]:
        mesh = trimesh.Trimesh(made.parts[name].mesh.vertices, made.parts[name].mesh.faces)
        assert mesh.is_watertight and mesh.volume > 0


def test_an_impossible_clearance_is_refused():
    """Too tight for the printer, too wide for the bulbs: each a clear error."""
    tight = load_specification().model_copy(update={"clearance": 0.05})
    with raises(InputError, "part.too-fine", match=r"clearance .*at least 0\.1 mm"):
        fit_to_printer(tight, PRINTER)
    wide = PRINTER.model_copy(update={"allowance": 0.5})
    with pytest.raises(InputError, match=r"below the minimum|must be"):
        fit_to_printer(load_specification(), wide)


def test_round_ends_and_sockets_have_their_corners_in_the_same_places():
    """A bulb of 2.88 in a socket of 3.08: other polygons for each would lack 3.5 % of the clearance."""
    values = load_specification().model_dump()
    values["strip"]["bulb_diameter"], values["fitting"]["stand_off"] = 2.88, 2.0
    spec = fit_to_printer(Specification.from_json(values), PRINTER)
    assert smallest_gap(assemble(body(*TRIANGLE), spec))[0] == pytest.approx(spec.clearance, rel=0.01)


@pytest.mark.parametrize("allowance", [-0.0, 0.03, 0.1])
def test_parts_fit_whatever_the_printers_allowance_is(allowance):
    printer = PRINTER.model_copy(update={"allowance": allowance})
    spec = fit_to_printer(load_specification(), printer)
    gap, one, other = smallest_gap(assemble(body(*WHEEL), spec))
    assert gap == pytest.approx(0.1 + allowance, rel=0.02), (one, other)


def test_parts_that_do_not_fit_are_found_before_anything_is_written():
    """A clearance that is asked and not made: a specification past its own checks."""
    asked = SPEC.model_copy(update={"coil": SPEC.coil, "clearance": 0.1})
    robot = design(*TRIANGLE)
    report = check(robot.morphology, asked, PRINTER)
    loose = asked.model_copy(update={"strip": asked.strip.model_copy(update={"height": 5.15})})
    with raises(EldirError, "part.no-clearance", match=r"0\.1 mm between them; found 0\.0"):
        make_content(robot, report, loose, PRINTER)
