"""A plate's 3MF, read by another program, has every part turned and placed as the plate has it."""

import io
import math

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from eldir_cad.geometry.parts import mass
from eldir_cad.geometry.plates import Item, Plate, threemf
from eldir_cad.kit.printer import fit_to_printer, load_printer
from eldir_cad.kit.specification import load_specification

SPEC = fit_to_printer(load_specification(), load_printer())
# Corners on the three axes, each at its own distance: no turn but none leaves it as it is.
TETRAHEDRON = trimesh.Trimesh(
    [[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
)


def read_back(archive):
    """All corners that a slicer sees, in order."""
    found = trimesh.load(io.BytesIO(archive), file_type="3mf").to_geometry().vertices
    return found[np.lexsort(found.round(4).T)]


@pytest.mark.parametrize(
    ("turn", "corners"),
    [
        # Counter-clockwise as seen from above: +x becomes +y, and +y becomes -x.
        (Rotation.from_euler("z", 90, degrees=True), [[0, 0, 0], [0, 1, 0], [-2, 0, 0], [0, 0, 3]]),
        # +x becomes -z, so the tip, which was up, points to +x.
        (Rotation.from_euler("y", 90, degrees=True), [[0, 0, 0], [0, 0, -1], [0, 2, 0], [3, 0, 0]]),
        (
            Rotation.from_euler("z", 30, degrees=True),
            [[0, 0, 0], [math.sqrt(3) / 2, 0.5, 0], [-1, math.sqrt(3), 0], [0, 0, 3]],
        ),
    ],
)
def test_a_part_is_turned_the_way_it_was_placed(turn, corners):
    at = np.array([20.0, 30.0, 4.0])
    archive = threemf("plate", {"tip": TETRAHEDRON}, [Item("tip", turn.as_matrix(), at)])
    wanted = np.array(corners) + at
    np.testing.assert_allclose(read_back(archive), wanted[np.lexsort(wanted.round(4).T)], atol=1e-4)


def test_both_files_of_a_plate_show_a_turned_part_alike():
    """A mass whose single socket points to one side: after half a turn it would be another mass."""
    part = mass(SPEC, 7, [1], "back")
    quarter = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    items = (
        Item(part.name, np.eye(3), np.array([10, 10, 0.0])),
        Item(part.name, quarter, np.array([40, 10, 0.0])),
    )
    plate = Plate("plate_01", {part.name: part}, items)
    whole = trimesh.load(io.BytesIO(plate.stl()), file_type="stl")
    scene = trimesh.load(io.BytesIO(plate.threemf()), file_type="3mf").to_geometry()
    np.testing.assert_allclose(scene.center_mass, whole.center_mass, atol=1e-3)
    np.testing.assert_allclose(scene.moment_inertia, whole.moment_inertia, rtol=1e-3)
