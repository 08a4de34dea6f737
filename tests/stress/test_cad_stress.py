"""Twenty designs of a run through filter and packet, and every plate of some through a slicer.

The figures that it prints (`-s`) are those of docs/reference/packet.md.
"""

import json
import resource
import time

import numpy as np
import pytest
import trimesh

from eldir.controller import Controller
from eldir.design import Design
from eldir.evolution.designs import load_run
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.run_folder import RunFolder
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import develop
from eldir.scene import Scene
from eldir_cad.checks.buildability import check
from eldir_cad.geometry.parts import cap, strip
from eldir_cad.geometry.plates import Item, threemf
from eldir_cad.kit.printer import fit_to_printer, load_printer
from eldir_cad.kit.specification import load_specification
from eldir_cad.packet.coupon import coupon_part, write_coupon
from eldir_cad.packet.folder import write_packet
from tests.cad.geometry.slicing import MISSING, SLICER, slice_plate
from tests.eldir.evolution.run_folders import go_on

pytestmark = pytest.mark.stress

PRINTER = load_printer()
SPEC = fit_to_printer(load_specification(), PRINTER)


def random_design(rows, columns, motors, seed):
    rng = np.random.default_rng(seed)
    lattice = Lattice(rows, columns)
    genotype = random_genotypes(lattice, 1, rng, motors)[0]
    body = develop(lattice, genotype)
    controller = Controller.random(len(body.positions), body.motors, rng)
    return Design(lattice, genotype, controller, Scene.preset("paper"))


@pytest.fixture(scope="module")
def designs(tmp_path_factory):
    """The last generation of a small run, evolved for building."""
    config = EvolutionConfig(
        Lattice(6, 11), population=20, generations=1, max_active=2, static_margin=0.02, iterations=2, seed=7
    )
    run = RunFolder.create(tmp_path_factory.mktemp("runs") / "run", config)
    go_on(run, run.restore())
    found = load_run(run.path)
    assert len(found) == 20
    return found


@pytest.mark.parametrize("index", range(20))
def test_designs_of_a_run_become_packets(tmp_path, designs, index):
    design = designs[index]
    report = check(design.morphology, SPEC, PRINTER)
    start = time.process_time()
    made = write_packet(design, tmp_path / "packet")
    seconds = time.process_time() - start
    assert made.report == report and report.buildable
    assert seconds < 10
    manifest = json.loads((tmp_path / "packet" / "manifest.json").read_text())
    assert manifest == made.manifest.to_json()
    for path in (tmp_path / "packet" / "parts").glob("*.stl"):
        mesh = trimesh.load(path)
        assert mesh.is_watertight and mesh.volume > 0
        assert mesh.volume == pytest.approx(manifest["parts"][path.stem]["volume_mm3"], rel=1e-4)
    assert manifest["clearance"]["tightest_mm"] == pytest.approx(SPEC.clearance, rel=0.02)
    kinds = sorted({v.kind for v in report.violations if v.severity != "note"})
    print(f"design {index}: {seconds:.1f} s, {manifest['totals']}, unfit for {kinds or 'nothing'}")


@pytest.mark.skipif(SLICER is None, reason=MISSING)
@pytest.mark.parametrize("index", range(3))
def test_every_plate_is_sliced_without_a_warning(tmp_path, designs, index):
    made = write_packet(designs[index], tmp_path / "packet")
    plates = sorted((tmp_path / "packet" / "plates").glob("*.3mf"))
    sliced = [slice_plate(plate, PRINTER, tmp_path) for plate in plates]
    totals = made.manifest["totals"]
    assert sum(s.manifold for s in sliced) == totals["parts"]
    volume = sum(s.volume for s in sliced)
    assert volume == pytest.approx(totals["volume_mm3"], rel=0.01)
    print(f"design {index}: {len(plates)} plates, {totals}, sliced {volume:.0f} mm3, no warning")


@pytest.mark.skipif(SLICER is None, reason=MISSING)
def test_the_coupon_is_sliced_without_a_warning(tmp_path):
    write_coupon(tmp_path / "coupon")
    sliced = slice_plate(tmp_path / "coupon" / "plates" / "plate_01.3mf", PRINTER, tmp_path)
    expected = coupon_part(load_specification()).volume + 2 * strip(SPEC).volume + 2 * cap(SPEC).volume
    assert sliced.manifold == 5
    assert sliced.volume == pytest.approx(expected, rel=0.01)


@pytest.mark.skipif(SLICER is None, reason=MISSING)
def test_the_slicer_tells_an_open_mesh(tmp_path):
    """The check is not blind: with one face left out, the object is no longer manifold."""
    mesh = cap(SPEC).mesh
    for name, faces in (("whole", mesh.faces), ("open", mesh.faces[1:])):
        part = trimesh.Trimesh(mesh.vertices, faces, process=False)
        middle = np.array([90.0, 50.0, 0.0])
        (tmp_path / f"{name}.3mf").write_bytes(threemf(name, {name: part}, [Item(name, np.eye(3), middle)]))
    assert slice_plate(tmp_path / "whole.3mf", PRINTER, tmp_path).manifold == 1
    with pytest.raises(AssertionError):
        assert slice_plate(tmp_path / "open.3mf", PRINTER, tmp_path).manifold == 1


@pytest.mark.parametrize(("rows", "columns", "masses", "limit"), [(6, 11, 45, 10), (13, 22, 84, 60)])
def test_limits_of_time_and_memory(tmp_path, rows, columns, masses, limit):
    """The body of the workspace and one of the paper's size, with the masses that it has on average."""
    room = SPEC.workspace.model_copy(update={"rows": rows, "columns": columns})
    spec = load_specification().model_copy(update={"workspace": room})
    if rows == 6:
        found = design_that_fills(rows, columns)
    else:
        found = min(
            (random_design(rows, columns, 2, seed) for seed in range(40)),
            key=lambda d: abs(len(d.morphology.positions) - masses),
        )
    start, cpu = time.perf_counter(), time.process_time()
    made = write_packet(found, tmp_path / "packet", spec)
    wall, cpu = time.perf_counter() - start, time.process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(
        f"{rows} x {columns}: {len(found.morphology.positions)} masses, "
        f"{len(found.morphology.springs)} springs "
        f"a face, {made.manifest['totals']}: {wall:.1f} s, {cpu:.1f} s of one core, {peak:.2f} GB"
    )
    assert cpu < limit and peak < 1


def design_that_fills(rows, columns):
    from tests.cad.drawn_bodies import design

    return design(*["1" * columns] * rows, motors=(3, 20))
