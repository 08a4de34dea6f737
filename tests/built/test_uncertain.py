"""What an identification turns: each knob moves what it says, and two leave all motion as it was."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

from eldir.built.heat import SpringState, heat
from eldir.built.motion import drive
from eldir.built.robot import build
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.uncertain import KNOBS, QUANTITIES, specimen
from hardware.virtual.far import far_from
from tests.built.filmed_walker import recording, scene
from tests.calibration.rigs import SOFT, heating, walker

__all__ = ["recording", "scene"]  # fixtures


def test_heavier_hotter_or_more_resistant_moves_the_same() -> None:
    """The silent knobs, against the engine and the heat model: motion and temperatures stay."""
    body, on = walker(), heating(1)[:600]
    robots, tables, silent = [], [], [name for name, knob in KNOBS.items() if knob.silent]
    assert silent == ["weight", "heat", "resistance"]
    for z in (0.0, 2.0):
        built, springs = specimen(SOFT, silent, [z] * len(silent))
        history = heat(on, 0.05, springs, SpringState.cold(2, springs))
        robots.append(build(body.morphology, built))
        tables.append(np.concatenate([np.full((1, 2), springs.cold_length), history.length]))
    assert robots[1].masses.sum() == pytest.approx(robots[0].masses.sum() * np.exp(0.1), rel=1e-9)
    assert np.abs(tables[1] - tables[0]).max() < 1e-9
    a, b = (m.positions for m in drive(robots, [tables[0]] * 2, 0.05))
    assert np.abs(a - b).max() < 1e-4 and np.ptp(a, axis=0).max() > 1e-2


def test_every_knob_turns_what_it_says() -> None:
    for name, knob in KNOBS.items():
        turned = specimen(SOFT, [name], [1.0])
        changed = {
            field
            for part, other in zip(SOFT, turned, strict=True)
            for field, value in asdict(part).items()  # vars() has what was computed and kept, too
            if value != getattr(other, field)
        }
        # A pinned strip has no bending stiffness to scale.
        assert changed == set(knob.powers) - {"bending"}, name
    for name, quantity in QUANTITIES.items():
        by = quantity.by(tuple(KNOBS))
        for j, knob in enumerate(KNOBS):
            there = quantity.value(specimen(SOFT, [knob], [0.01]))
            change = there - quantity.value(SOFT) if quantity.shifts else np.log(there / quantity.value(SOFT))
            assert change == pytest.approx(0.01 * by[j], abs=1e-9), (name, knob)


def test_defaults_are_the_rigs() -> None:
    assert set(KNOBS["weight"].powers) <= set(BuiltParameters().to_json())
    assert set(KNOBS["heat"].powers) <= set(vars(SpringParameters()))


def test_far_rigs_are_far_and_each_its_own() -> None:
    for seed in range(20):
        built, springs = far_from(SOFT, seed)
        off = {
            n: abs(QUANTITIES[n].value((built, springs)) / QUANTITIES[n].value(SOFT) - 1)
            for n in ("hot_length", "cold_length", "current", "cooling", "friction", "hot_stiffness")
        }
        assert 0.1 <= off["friction"] <= 0.5 and 0.1 <= off["cooling"] <= 0.4
        assert 0.1 <= off["hot_length"] <= 0.2 and 0.1 <= off["cold_length"] <= 0.3
        assert off["hot_stiffness"] < 0.7 and springs.cold_length < springs.hot_length
    assert far_from(SOFT, 1) == far_from(SOFT, 1) != far_from(SOFT, 2)
