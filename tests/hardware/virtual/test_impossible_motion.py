"""What a simulated robot does that a printed one cannot do."""

from __future__ import annotations

import numpy as np
import pytest

from eldir.built.robot import build
from eldir.lattice import Lattice
from eldir.parameters.springs import SpringParameters
from eldir_cad.kit.specification import load_specification
from eldir_cad.multibody.model import CoilSpring
from eldir_hardware.virtual.bodies import Dimensions, Physics, virtual_body
from eldir_hardware.virtual.impossible_motion import ImpossibleMotion, OverlapCheck, describe_buckling
from eldir_hardware.virtual.mujoco_body import MujocoMotion
from tests.eldir.random_design import make_design
from tests.hardware.virtual.multibody_models import hub, small

pytest.importorskip("mujoco")  # installed with the extra `test`
BODY = make_design(3, Lattice(3, 6)).morphology
SPRINGS = SpringParameters()
COIL = SPRINGS.coil_diameter + SPRINGS.wire_diameter


def test_hubs_that_pass_through_strips_are_named() -> None:
    """Contact with strips is not simulated, so the log has to say so."""
    overlap = OverlapCheck(BODY, load_specification(), COIL)
    places = build(BODY).positions.copy()
    assert overlap.worst_pair(places) is None
    (a, b), other = BODY.springs[0], int(next(i for i in range(len(places)) if i not in BODY.springs[0]))
    places[other] = (places[a] + places[b]) / 2
    assert overlap.worst_pair(places) == f"mass {other} and spring {a}-{b}"


def test_a_wide_coil_touches_sooner() -> None:
    usual, wide = (OverlapCheck(BODY, load_specification(), diameter) for diameter in (COIL, 2 * COIL))
    places = build(BODY).positions.copy()
    a, b = BODY.springs[BODY.active][0]
    other = int(next(i for i in range(len(places)) if i not in (a, b)))
    along = (places[b] - places[a]) / np.linalg.norm(places[b] - places[a])
    # A hub is 12 mm wide and a coil 7.25 mm: they touch at 9.6 mm, with twice the coil at 13.2 mm.
    places[other] = (places[a] + places[b]) / 2 + 12e-3 * np.array([-along[1], along[0]])
    reached = wide.worst_pair(places)
    assert reached is not None and f"spring {a}-{b}" in reached
    assert f"spring {a}-{b}" not in (usual.worst_pair(places) or "")


def test_the_first_of_each_kind_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = ImpossibleMotion(BODY, SPRINGS)
    monkeypatch.setattr(OverlapCheck, "worst_pair", lambda self, positions: "mass 1 and spring 2-3")
    ends = ["-".join(map(str, pair)) for pair in BODY.springs[BODY.active].tolist()]
    loads = np.full((BODY.motors, 2), -3.0)
    seen.look(1.0, {}, loads.ravel())
    assert seen.remark == ""
    loads[1, 1] = 1.01
    seen.look(2.0, {}, loads.ravel())
    buckles = f"the coil of spring {ends[1]} would buckle on a printed robot, first 2.0 s after power-on"
    assert seen.remark == buckles
    loads[0, 0] = 5.0
    seen.look(3.0, {"back": np.zeros((1, 3))}, loads.ravel())
    assert seen.remark == (
        f"mass 1 and spring 2-3 of the back pass through each other, first 3.0 s after power-on; {buckles}"
    )


@pytest.mark.parametrize(("load", "tells"), [(0.99, False), (1.0, False), (1.01, True), (-7.0, False)])
def test_a_coil_buckles_beyond_its_load(load: float, tells: bool) -> None:
    assert bool(describe_buckling(BODY, np.array([0.0, load]), 1.0)) == tells


@pytest.mark.parametrize("shortened", [-1e-3, 1.9e-3, 2.1e-3])
def test_the_load_of_a_coil_is_its_shortening_over_that_at_which_it_buckles(shortened: float) -> None:
    """Between two hubs so heavy that they stay: 2.0 mm at 68 mm, docs/reference/built.md."""
    free = SPRINGS.hot_length
    heavy = [hub(x, mass=1e6, inertia=1e6) for x in (0.0, free - shortened)]
    motion = MujocoMotion(
        small(heavy, coils=[CoilSpring((0, 1), (98.0, 248.0), 1.0)], corner=7e-3, max_rotation=0.2),
        (SPRINGS.cold_length, free),
    )
    motion.follow(np.full((2, 1), free), 0.05)
    (load,) = motion.coil_loads(np.array([free]), SPRINGS)
    assert load == pytest.approx(shortened / SPRINGS.buckling_shortening(np.array(free)), abs=1e-4)
    assert (load > 1) == (shortened > 2.0e-3)


@pytest.mark.parametrize(("physics", "dimensions"), [("eldir", 2), ("mujoco", 2), ("mujoco", 3)])
def test_a_coil_that_would_buckle_is_told(physics: Physics, dimensions: Dimensions) -> None:
    """Heated in no time, the coil is longer before the robot's weight lets it be."""
    robot = virtual_body(physics, BODY, 4, SPRINGS, np.zeros(len(BODY.positions)), dimensions=dimensions)
    lengths = np.full((2, BODY.motors, 2), SPRINGS.cold_length)
    robot.move(lengths, 0.05)
    assert robot.remark == ""
    lengths[:, 1] += 0.8 * (SPRINGS.hot_length - SPRINGS.cold_length)
    robot.move(lengths[:1], 0.01)
    a, b = BODY.springs[BODY.active][1]
    assert (
        robot.remark
        == f"the coil of spring {a}-{b} would buckle on a printed robot, first 0.1 s after power-on"
    )
