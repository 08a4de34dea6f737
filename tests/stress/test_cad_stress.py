"""Twenty random designs through filter and packet, three of them through a slicer."""

import json
import shutil
import subprocess

import numpy as np
import pytest
import trimesh

from cad.assembly import assemble, tightest
from cad.packet import write_packet
from cad.specification import fit, load_printer, load_specification
from eldir.controller import Controller
from eldir.design import Design
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import develop
from eldir.scene import Scene

pytestmark = pytest.mark.stress


@pytest.mark.parametrize("seed", range(20))
def test_random_designs_become_packets(tmp_path, seed):
    rng = np.random.default_rng(seed)
    lattice = Lattice(6, 11)
    genotype = random_genotypes(lattice, 1, rng, 2)[0]
    body = develop(lattice, genotype)
    controller = Controller.random(len(body.positions), body.motors, rng)
    made = write_packet(Design(lattice, genotype, controller, Scene.preset("paper")), tmp_path / "packet")
    for path in (tmp_path / "packet" / "parts").glob("*.stl"):
        mesh = trimesh.load(path)
        assert mesh.is_watertight and mesh.volume > 0
    assert json.loads((tmp_path / "packet" / "manifest.json").read_text()) == made.manifest
    spec = fit(load_specification(), load_printer())
    gap, one, other = tightest(assemble(body, spec))
    assert gap == pytest.approx(spec.clearance, rel=0.01), (one, other)
    if seed < 3 and shutil.which("prusa-slicer"):
        _slice(tmp_path)


def _slice(folder):
    plates = folder / "packet" / "plates"
    for plate in plates.glob("*.3mf"):
        result = subprocess.run(
            ["prusa-slicer", "--export-sla", "--load", plates / "slicer.ini", "--dont-arrange",
             "-o", folder / "plate.sl1", plate],
            capture_output=True, text=True, timeout=300, check=True,
        )  # fmt: skip
        assert "warning" not in (result.stdout + result.stderr).lower()
