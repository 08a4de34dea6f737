"""Numbers of a rig file that cannot be true are refused, in one line that names them."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from eldir.errors import EldirError, InputError
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.rig.template import CURRENT_LIMIT_A, real_rig, virtual_rig
from eldir_hardware.safety import limits
from eldir_hardware.safety.compatibility import HEAT_SECTIONS
from tests.hardware.rigs_and_schedules import SCHEDULE, gait, rig_with
from tests.paths import ROOT

BASE = rig_with(
    springs={"convection_still": 30.0},
    board={"channels": 8},
    fan={"interlocked": True, "channel": 5},
).to_json()
THERMAL = BASE | {"cutoff": {"kind": "thermal", "opens_at_c": 85.0}}
HARMLESS = {  # of the sections that decide how hot springs get
    ("springs.latent_heat", 0.001): "springs that need less heat to transform are predicted hotter",
    ("supply.lead_resistance_ohm", 0.001): "less resistance of the leads gives more heat, not less",
    ("tolerances.ambient_min_c", 0.001): "nothing gets hotter in colder air",
}


def numbers(values: Any, path: tuple = ()) -> Iterator[tuple[tuple, float]]:
    if isinstance(values, dict | list):
        for key, value in values.items() if isinstance(values, dict) else enumerate(values):
            yield from numbers(value, (*path, key))
    elif isinstance(values, int | float) and not isinstance(values, bool):
        yield path, values


def changed(values: Any, path: tuple, new: object) -> Any:
    if not path:
        return new
    if isinstance(values, list):
        return [changed(v, path[1:], new) if i == path[0] else v for i, v in enumerate(values)]
    return values | {path[0]: changed(values[path[0]], path[1:], new)}


def accepted(values: dict[str, Any]) -> bool:
    try:
        limits.check_schedule(SCHEDULE, Rig.from_json(values))
    except EldirError:
        return False
    return True


def test_a_thousandfold_error_of_any_number_is_refused_or_harmless():
    found = set()
    for base in (BASE, THERMAL):
        assert accepted(base)
        for path, value in numbers({name: base[name] for name in (*HEAT_SECTIONS, "board")}):
            for factor in (1000, 0.001):
                new = value * factor
                if new != value and accepted(changed(base, path, new)):
                    found.add((".".join(map(str, path)), factor))
    assert found == set(HARMLESS)


@pytest.mark.parametrize(
    "value", [float("nan"), float("inf"), pytest.param(-float("inf"), marks=pytest.mark.stress)]
)
def test_no_number_may_be_missing_or_infinite(value):
    for base in (BASE, THERMAL):
        for path, _ in numbers(base):
            with pytest.raises(InputError):
                Rig.from_json(changed(base, path, value))


@pytest.mark.parametrize(
    ("section", "values", "message"),
    [
        ("springs", {"resistance_ohm": 9.87}, r"9.87 does not fit 0.545 m of wire of 0.75 mm: .*"
         r"0.494 to 1.6 Ohm"),
        ("springs", {"wire_diameter_mm": 0.38}, r"resistance_ohm 0.987 does not fit"),
        ("springs", {"turns": 80, "cold_length_mm": 60}, r"resistance_ohm 0.987 does not fit 1.63 m"),
        ("springs", {"coil_diameter_mm": 20}, "26.7 times wire_diameter_mm, expected 3 to 20"),
        ("springs", {"austenite_finish_c": 44}, r"austenite_start_c must be less than austenite_finish_c"),
        ("springs", {"martensite_start_c": 29}, r"martensite_finish_c must be less than martensite_start_c"),
        ("springs", {"austenite_finish_c": 200}, "invalid springs.austenite_finish_c; expected less"),
        ("springs", {"hot_length_mm": 30}, r"cold_length_mm must be less than hot_length_mm"),
        ("springs", {"heat_capacity": 0.466}, "invalid springs.heat_capacity; expected greater"),
        ("springs", {"ambient_c": 35}, r"springs.ambient_c 35 lies outside tolerances, 18 to 30 C"),
        ("cutoff", {"kind": "thermal", "opens_at_c": float("nan")}, r"'\.nan' is not a finite number"),
        ("board", {"port": "socket://bench:4001"}, "board.port: socket://hidden is not a serial port of"),
        ("limits", {"max_temperature_c": float("nan")}, r"'\.nan' is not a finite number in line [0-9]+"),
    ],
)  # fmt: skip
def test_the_error_names_the_entry(tmp_path: Path, section, values, message):
    rig = yaml.safe_load(virtual_rig())
    rig[section] = values if "kind" in values else rig[section] | values
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(rig))
    with pytest.raises(InputError, match=message) as raised:
        Rig.load(path)
    assert "\n" not in str(raised.value)


def test_other_springs_that_are_wound_are_accepted():
    """Those of the table in the design notes: 0.38 to 1 mm wire, close-coiled to 20 mm."""
    for wire, coil, ohm in ((0.38, 4, 4.2), (0.5, 5, 2.3), (0.75, 6.5, 0.87), (1.0, 7, 0.38)):
        turns = 20 / wire
        springs = {"wire_diameter_mm": wire, "coil_diameter_mm": coil, "turns": turns, "resistance_ohm": ohm}
        assert rig_with(springs=springs).springs.resistance_ohm == ohm


def test_rig_files_and_parts_have_the_same_current_and_it_is_the_maximum():
    """A twentieth of an ampere more is refused; the parts list says the same number."""
    rig = Rig.from_json(yaml.safe_load(virtual_rig()))
    parts = yaml.safe_load((ROOT / "cad" / "eldir_cad" / "kit" / "data" / "parts.yaml").read_text())
    assert rig.supply.current_limit_a == CURRENT_LIMIT_A
    assert parts["coil"]["current_limit_a"] == CURRENT_LIMIT_A
    comments = " ".join(real_rig("lcus", "/dev/null").replace("#", "").split())
    assert f"allow {CURRENT_LIMIT_A:g} A" in comments
    longest = gait(duty=(0.2, 0.2), period=30.0)
    compile_schedule(longest, rig)
    with pytest.raises(LimitError):
        compile_schedule(longest, rig_with(supply={"current_limit_a": CURRENT_LIMIT_A + 0.05}))
