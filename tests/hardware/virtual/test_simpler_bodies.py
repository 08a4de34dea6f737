"""The multibody model with one law taken away: exactly that law is gone."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from eldir.built.robot import build
from eldir_cad.multibody.model import (
    SIMPLIFICATIONS,
    Multibody,
    on_level_table,
    with_equal_feet,
    with_pins,
    without_hub_contact,
    without_socket_friction,
    without_socket_range,
)
from eldir_hardware.virtual.mujoco_body import MujocoMotion, sample_multibody
from tests.calibration.dynamics.hidden_rigs import walker
from tests.hardware.virtual.multibody_models import FREE, LENGTH, hub, small, strip

pytest.importorskip("mujoco")  # installed with the extra `test`
BODY = walker().morphology
DRAWN = sample_multibody(BODY, 3)


def changed(model: Multibody) -> set[str]:
    return {f.name for f in fields(model) if getattr(model, f.name) is not getattr(DRAWN, f.name)}


def test_each_takes_away_what_it_names_and_nothing_else() -> None:
    assert DRAWN.tilt and len({h.friction for h in DRAWN.hubs}) == len(DRAWN.hubs)
    assert changed(on_level_table(DRAWN)) == {"tilt"} and on_level_table(DRAWN).tilt == 0
    alike = with_equal_feet(DRAWN)
    assert changed(alike) == {"hubs"} and len({h.friction for h in alike.hubs}) == 1
    assert [h.inertia for h in alike.hubs] == [h.inertia for h in DRAWN.hubs]
    assert changed(without_hub_contact(DRAWN)) == {"contact_radius"}
    assert changed(without_socket_friction(DRAWN)) == {"socket_friction"}
    assert changed(without_socket_range(DRAWN)) == {"max_rotation"}
    assert set(SIMPLIFICATIONS.values()) == {
        with_pins,
        without_socket_friction,
        without_socket_range,
        with_equal_feet,
        without_hub_contact,
        on_level_table,
    }


def test_pins_leave_masses_friction_and_the_distances_of_the_built_scene() -> None:
    points, there = with_pins(DRAWN), build(BODY)
    assert points.tilt == DRAWN.tilt and points.contact_radius == DRAWN.contact_radius
    assert [h.friction for h in points.hubs] == [h.friction for h in DRAWN.hubs]
    assert [h.inertia.mass for h in points.hubs] == [h.inertia.mass for h in DRAWN.hubs]
    drawn = [s.length - LENGTH for s in DRAWN.strips]
    pitch = there.parameters.pitch
    assert [s.length - pitch for s in points.strips] == pytest.approx(drawn, abs=1e-12)
    motion = MujocoMotion(points, FREE)
    assert np.ptp(motion.positions, axis=0) == pytest.approx(np.ptp(there.positions, axis=0), abs=1e-6)


def test_sockets_let_a_strip_turn_without_their_range_and_their_friction() -> None:
    """A force that a socket holds, and one that bends its strip at 15 degrees."""

    def turned(model: Multibody, force: float) -> float:
        motion = MujocoMotion(model, FREE)
        motion.data.xfrc_applied[-1, 2] = force
        motion.follow(np.zeros((21, 0)), 0.05)
        place, hinge = motion.data.xpos[-1], motion.data.xpos[1]
        return abs(float(np.degrees(np.arctan2(place[2] - hinge[2], place[0] - hinge[0]))))

    heavy, light = hub(0.0, mass=1e3, inertia=1e3), hub(LENGTH + 2 * 3.7e-3)
    held = small(
        [heavy, light], [strip()], socket=3.7e-3, max_rotation=np.radians(15), socket_friction=2e-4, drag=20.0
    )
    assert turned(held, 0.2) < 25 < turned(without_socket_range(held), 0.2)
    weak = 0.8 * 2e-4 / LENGTH
    assert turned(held, weak) < 0.6 < turned(without_socket_friction(held), weak)


def test_hubs_pass_through_each_other_without_contact() -> None:
    def least(model: Multibody) -> float:
        motion = MujocoMotion(model, FREE)
        motion.data.xfrc_applied[1:, 0] = 0.1, -0.1
        motion.follow(np.zeros((21, 0)), 0.05)
        return float(motion.positions[0, 0] - motion.positions[1, 0])

    apart = small([hub(0.0), hub(0.05)], corner=7e-3, max_rotation=0.2, drag=20.0)
    assert least(apart) < -0.011
    assert least(without_hub_contact(apart)) > 0, "they have changed places"


def test_a_level_table_is_level() -> None:
    steep = replace(small([hub(0.0)], gravity=-9.81), tilt=float(np.arctan(0.6)))
    slid = []
    for model in (steep, on_level_table(steep)):
        motion = MujocoMotion(model, FREE)
        motion.follow(np.zeros((21, 0)), 0.05)
        slid.append(float(motion.positions[0, 0]))
    assert slid[0] > 0.1 and abs(slid[1]) < 1e-6
