"""Uncertain parameters: each changes its fields, and three combinations change no motion."""

from __future__ import annotations

import runpy
from dataclasses import asdict, replace

import numpy as np
import pytest

from eldir.built.heat import SpringState, heat
from eldir.built.motion import drive
from eldir.built.robot import build
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import QUANTITIES, RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.uncertain import PARAMETERS, applicable_parameters
from eldir_hardware.virtual.bodies import sample_large_spread
from tests.calibration.dynamics.hidden_rigs import SOFT, heating, walker
from tests.paths import ROOT

HUBS = replace(SOFT, printed=SOFT.printed.with_hubs())


@pytest.mark.parametrize(
    ("nominal", "intervals", "moved"), [(SOFT, 600, 1e-2), (HUBS, 100, 1e-3)], ids=["pins", "hubs"]
)
def test_heavier_hotter_or_more_resistant_moves_the_same(
    nominal: RobotParameters, intervals: int, moved: float
) -> None:
    """The unobservable parameters, against the engine and the heat model: motion and temperatures stay."""
    body, on = walker(), heating(1)[:intervals]
    robots, tables, unobservable = (
        [],
        [],
        [name for name, parameter in PARAMETERS.items() if parameter.unobservable],
    )
    assert unobservable == ["weight", "heat", "resistance"]
    for z in (0.0, 2.0):
        robot = nominal.at(unobservable, [z] * len(unobservable))
        springs = robot.springs
        history = heat(on, 0.05, springs, SpringState.cold(2, springs))
        robots.append(build(body.morphology, robot))
        tables.append(np.concatenate([np.full((1, 2), springs.cold_length), history.length]))
    assert robots[1].masses.sum() == pytest.approx(robots[0].masses.sum() * np.exp(0.1), rel=1e-9)
    assert np.abs(tables[1] - tables[0]).max() < 1e-9
    a, b = (m.positions for m in drive(robots, [tables[0]] * 2, 0.05))
    # With hubs until a corner lands one way or the other by the last bit, after 5 s.
    assert np.abs(a - b).max() < 1e-4 and np.ptp(a, axis=0).max() > moved


def test_every_parameter_changes_its_fields() -> None:
    for name, parameter in PARAMETERS.items():
        moved = HUBS.at([name], [1.0])
        changed = {
            field
            for part, other in ((HUBS.printed, moved.printed), (HUBS.springs, moved.springs))
            for field, value in asdict(part).items()  # vars() has what was computed and kept, too
            if value != getattr(other, field)
        }
        assert changed == set(parameter.powers), name
    for name, quantity in QUANTITIES.items():
        by = quantity.gradient(tuple(PARAMETERS))
        for j, other in enumerate(PARAMETERS):
            there, here = quantity.value(HUBS.at([other], [0.01])), quantity.value(HUBS)
            change = there - here if quantity.additive else np.log(there / here)
            assert change == pytest.approx(0.01 * by[j], abs=1e-9), (name, other)


def test_only_hubs_have_friction_in_sockets() -> None:
    absent = set(PARAMETERS) - set(applicable_parameters(SOFT.printed))
    acting = {f for f in asdict(SOFT.printed) if SOFT.printed.acts(f)} | set(asdict(SOFT.springs))
    idle = {name for name, parameter in PARAMETERS.items() if acting.isdisjoint(parameter.powers)}
    assert "socket_friction" in absent and absent == idle
    assert applicable_parameters(HUBS.printed) == tuple(PARAMETERS)
    assert applicable_parameters(BuiltParameters.clamped(), ("socket_friction", "buckling")) == ("buckling",)


def test_defaults_are_the_rigs() -> None:
    assert set(PARAMETERS["weight"].powers) <= set(BuiltParameters().to_json())
    assert set(PARAMETERS["heat"].powers) <= set(vars(SpringParameters()))


def test_the_page_has_the_tables_of_the_fields() -> None:
    written = runpy.run_path(str(ROOT / "docs" / "site" / "parameters.py"))
    page = (ROOT / "docs" / "reference" / "dynamics.md").read_text()
    assert page == written["page_text"](), "run: python docs/site/parameters.py"
    assert "| `current` | 25 % | `current_limit`, `supply_voltage` | supply setting" in page
    assert "| `hot_length` [m] | 15 % | 1 mm | 2 % | 10 to 20 % |" in page


def test_quantities_have_the_units_of_their_fields() -> None:
    units = {name: quantity.unit for name, quantity in QUANTITIES.items()}
    assert len(units) == len(PARAMETERS)
    expected = {"friction": "1", "hot_length": "m", "printed_mass": "kg", "cooling": "W/(m2 K)",
                "transition": "C", "current": "A", "resistivity": "Ohm m"}  # fmt: skip
    assert units | expected == units


def test_far_rigs_are_far_and_each_its_own() -> None:
    for seed in range(20):
        far = sample_large_spread(SOFT, seed)
        off = {
            n: abs(QUANTITIES[n].value(far) / QUANTITIES[n].value(SOFT) - 1)
            for n in ("hot_length", "cold_length", "current", "cooling", "friction", "hot_stiffness")
        }
        assert 0.1 <= off["friction"] <= 0.5 and 0.1 <= off["cooling"] <= 0.4
        assert 0.1 <= off["hot_length"] <= 0.2 and 0.1 <= off["cold_length"] <= 0.3
        assert off["hot_stiffness"] < 0.7 and far.springs.cold_length < far.springs.hot_length
    assert sample_large_spread(SOFT, 1) == sample_large_spread(SOFT, 1) != sample_large_spread(SOFT, 2)


def test_what_was_measured_is_not_far_and_nothing_else_changes() -> None:
    for seed in range(20):
        far, known = (sample_large_spread(SOFT, seed, measured=m) for m in ((), ("current_limit",)))
        assert known.springs.current_limit == SOFT.springs.current_limit != far.springs.current_limit
        assert replace(known.springs, current_limit=far.springs.current_limit) == far.springs
        assert known.printed == far.printed
