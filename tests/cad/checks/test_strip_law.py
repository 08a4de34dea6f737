"""What the parts say to the simulation: one geometry, and a strip's force against other ways to find it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters
from eldir_cad.checks.strip_law import (
    StripLaw,
    built_parameters,
    hub_parameters,
    on_supply_of,
    spring_parameters,
)
from eldir_cad.geometry.parts import strip
from eldir_cad.kit.printer import fit_to_printer, load_printer
from eldir_cad.kit.specification import load_specification
from eldir_hardware.markers.registration import DISC_DIAMETER
from eldir_hardware.rig.sections import SpringEntry
from eldir_hardware.rig.template import CURRENT_LIMIT_A
from eldir_hardware.vision.virtual_camera import HUB_RADIUS, STRIP_THICKNESS

PRINTER = load_printer()
SPEC = fit_to_printer(load_specification(), PRINTER)
CLAMPED = SPEC.model_copy(update={"strip": SPEC.strip.model_copy(update={"turn_deg": 0.0})})
PINNED_LAW, CLAMPED_LAW = StripLaw.of(SPEC, PRINTER), StripLaw.of(CLAMPED, PRINTER)


def test_parts_and_built_scene_are_one_geometry():
    """The defaults of the built scene, the springs, the rig and the camera are those of the kit."""
    assert built_parameters(SPEC, PRINTER) == BuiltParameters()
    assert built_parameters(CLAMPED, PRINTER) == BuiltParameters.clamped()
    springs = spring_parameters(SPEC)
    assert springs == replace(SpringParameters(), current_limit=CURRENT_LIMIT_A)
    entry = SpringEntry.model_fields
    lengths = entry["cold_length_mm"].default, entry["hot_length_mm"].default
    assert lengths == SPEC.motor_range == (1e3 * springs.cold_length, 1e3 * springs.hot_length)
    assert pytest.approx(1e3 * HUB_RADIUS, rel=1e-3) == SPEC.mass.across_flats / math.sqrt(3)
    assert SPEC.strip.thickness == 1e3 * STRIP_THICKNESS
    assert 0 < SPEC.mass.disc_diameter - 1e3 * DISC_DIAMETER <= 0.3


def test_other_parts_make_another_scene():
    thin = SPEC.model_copy(update={"strip": SPEC.strip.model_copy(update={"thickness": 0.6})})
    found, usual = built_parameters(thin, PRINTER), BuiltParameters()
    assert found.buckling == pytest.approx(0.216 * usual.buckling, rel=0.01)
    assert found.tension == pytest.approx(0.6 * usual.tension, rel=0.01)
    assert found.strip == pytest.approx(strip(thin).volume * 1.15e-6, rel=0.01)
    light = PRINTER.model_copy(update={"material": PRINTER.material.model_copy(update={"density": 0.575})})
    assert built_parameters(SPEC, light).hexagon == pytest.approx(usual.hexagon / 2, rel=0.01)


def test_another_coil_makes_another_spring():
    """Stiffness by G d^4 / (8 D^3 n), mass by the wire's length, of a coil of 8.25 mm mean diameter."""
    coil = SPEC.coil.model_copy(update={"outer_diameter": 9.0, "current_limit_a": 3.0})
    wide, ratio = SPEC.model_copy(update={"coil": coil}), 8.25 / 6.5
    springs, kit = spring_parameters(wide), spring_parameters(SPEC)
    assert springs == replace(kit, coil_diameter=8.25e-3, current_limit=3.0)
    assert springs.stiffness(0.0) == pytest.approx(23e9 * 0.75e-3**4 / (8 * 8.25e-3**3 * 26.7))
    for found, usual in (
        (built_parameters(wide, PRINTER), built_parameters(SPEC, PRINTER)),
        (hub_parameters(wide, PRINTER), hub_parameters(SPEC, PRINTER)),
    ):
        assert found.hot_stiffness == pytest.approx(124.0 / ratio**3) == pytest.approx(60.65, abs=0.01)
        assert found.cold_stiffness == pytest.approx(49.0 / ratio**3)
        assert found.active_spring - usual.active_spring == pytest.approx((ratio - 1) * kit.mass)
        same = replace(
            found,
            **{n: getattr(usual, n) for n in ("hot_stiffness", "cold_stiffness", "active_spring")},
        )
        assert same == usual
    assert built_parameters(wide, PRINTER, kit) == built_parameters(SPEC, PRINTER)
    assert built_parameters(SPEC, PRINTER, springs) == built_parameters(wide, PRINTER)
    supply = replace(SpringParameters(), current_limit=2.5, ambient=18.0, fan=False, turns=20.0)
    assert on_supply_of(springs, supply) == replace(springs, current_limit=2.5, ambient=18.0, fan=False)


def test_eulers_load_by_hand():
    """pi2 E I / l2 over the 49.6 mm between two hinges; clamped, four times that over the free 45 mm."""
    second_moment = 5.0 * 1.0**3 / 12
    assert PINNED_LAW.buckling == pytest.approx(math.pi**2 * 2100 * second_moment / 49.6**2)
    assert CLAMPED_LAW.buckling == pytest.approx(4 * math.pi**2 * 2100 * second_moment / 45**2)
    assert PINNED_LAW.tension == pytest.approx(1600 * 5 / 49.6)
    assert CLAMPED_LAW.buckling / PINNED_LAW.buckling == pytest.approx(4 * (49.6 / 45) ** 2)


@pytest.mark.parametrize("shortening", [0.5, 3.0, 10.0, 18.0])
def test_a_pinned_strip_bends_as_its_differential_equation_says(shortening):
    """E I theta'' = -P sin(theta), no moment at the ends; shot from one end until the other fits."""
    law = PINNED_LAW
    share = shortening / law.length

    def shot(angle, load):
        rate = load / law.flexural_rigidity
        end = solve_ivp(
            lambda _s, y: [y[1], -rate * math.sin(y[0]), math.cos(y[0])],
            (0, law.length),
            [angle, 0.0, 0.0],
            rtol=1e-10,
            atol=1e-12,
        ).y[:, -1]
        return end[1], 1 - end[2] / law.length  # curvature at the far end, shortening

    def load_at(angle):
        return brentq(lambda p: shot(angle, p)[0], 0.98 * law.buckling, 2 * law.buckling)

    angle = brentq(lambda a: shot(a, load_at(a))[1] - share, 0.05, 2.0)
    load = load_at(angle)
    assert law.force(shortening) == pytest.approx(load, rel=1e-6)
    # The greatest curvature is where the strip runs along the load: theta'^2 = 2 P (1 - cos a) / E I.
    curvature = math.sqrt(2 * load * (1 - math.cos(angle)) / law.flexural_rigidity)
    assert law.surface_strain(shortening) == pytest.approx(law.thickness / 2 * curvature, rel=1e-6)


def test_shallow_bending_has_closed_forms():
    """A half-wave of height a is shorter by (pi a)^2 / 4 l and bends by pi2 a / l2; clamped, twice that."""
    for law, waves in ((PINNED_LAW, 1), (CLAMPED_LAW, 2)):
        short = 1e-2 * law.length
        assert law.force(short) == pytest.approx(law.buckling * (1 + short / law.length / 2), rel=2e-4)
        strain = waves * math.pi * law.thickness / law.length * math.sqrt(short / law.length)
        assert law.surface_strain(short) == pytest.approx(strain, rel=5e-3)
    # A 45 mm strip with pinned ends, shortened by a tenth (docs/reference/packet.md).
    pinned = StripLaw(45.0, 50.0, 5.0, 1.0, 1600.0, 2100.0, clamped=False)
    assert pinned.buckling == pytest.approx(4.26, abs=0.01)
    assert pinned.surface_strain(4.5) == pytest.approx(0.022, abs=0.001)


def test_the_built_scenes_branch_stays_with_the_elastica():
    """min(K s, PE (1 + s / 2L)), L from centre to centre, as `eldir.engine.built.strip` has it."""
    shortened, law = np.linspace(0, 0.3 * PINNED_LAW.length, 61), PINNED_LAW
    force = np.array([law.force(s) for s in shortened])
    branch = np.minimum(law.tension * shortened, law.buckling * (1 + shortened / 2 / law.pitch))
    assert np.abs(branch[1:] / force[1:] - 1).max() < 0.05
    assert (np.diff(force) > 0).all()


def test_no_strip_is_shortened_to_nothing():
    with pytest.raises(ValueError, match="cannot be shortened"):
        PINNED_LAW.force(60.0)
