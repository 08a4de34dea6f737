"""`eldir calibrate springs` on tables as loggers and spreadsheets write them, and with faults of sensors.

The tables come from an integration of the heat balance that shares nothing with the product.
"""

from __future__ import annotations

import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from eldir.errors import InputError
from eldir_app.application import application
from eldir_calibration.identification.spring_record import load_spring_recording
from eldir_calibration.springs.fit import SpringFit, fit_spring
from eldir_hardware.rig.configuration import Rig
from tests.calibration.springs.spring_recordings import FORMER
from tests.calibration.springs.spring_tables import Truth, measure, write
from tests.hardware.rigs_and_schedules import rig_text
from tests.processor_time import in_units
from tests.raised import raises

TRUTH = Truth()
LONG = pytest.mark.stress
"""A fit takes seconds; `make stress` has those that the others represent."""
CONSTANTS = (
    "heat_capacity", "latent_heat", "convection_still", "convection_fan", "resistance", "cold_length",
    "hot_length", "austenite_start", "austenite_finish", "martensite_start", "martensite_finish",
)  # fmt: skip
Table = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def table() -> Table:
    found = measure(TRUTH)
    del found["ambient_c"]
    return found


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory, table: Table) -> SpringFit:
    return fit(tmp_path_factory.mktemp("clean"), table)


def fit(folder: Path, table: Table, **how: str) -> SpringFit:
    return fit_spring(load_spring_recording(write(folder / "table.csv", table, **how)), FORMER)


def assert_found(found: SpringFit, truth: Truth = TRUTH, sigmas: float = 3.5) -> None:
    """Each constant is within its stated error, and that error is small enough to be of use."""
    for name in CONSTANTS:
        estimate, value = found.estimates[name], getattr(truth, name)
        assert abs(estimate.value - value) < sigmas / 1.96 * estimate.margin, (name, estimate, value)
        limit = 1.5 if name.endswith(("start", "finish")) else 0.05 * value
        assert estimate.margin < limit, (name, estimate)
    ambient = found.estimates["ambient"]
    assert abs(ambient.value - truth.ambient - truth.warming / 2) < max(sigmas / 1.96 * ambient.margin, 0.2)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=LONG)])
def test_constants_are_found_within_their_errors(tmp_path: Path, seed: int) -> None:
    table = measure(TRUTH, seed)
    del table["ambient_c"]
    started = time.process_time()
    found = fit(tmp_path, table)
    assert in_units(time.process_time() - started) < 3000, "for 1000 samples; it takes 700"
    assert_found(found)
    assert found.residual == pytest.approx(0.3, rel=0.1) and found.noise == pytest.approx(0.3, rel=0.15)
    assert found.faults == () and found.remarks == []


@pytest.mark.parametrize("measured", [False, pytest.param(True, marks=LONG)], ids=["unknown", "column"])
def test_surroundings_that_warm_up_do_not_change_the_loss(tmp_path: Path, measured: bool) -> None:
    truth = replace(TRUTH, warming=4.0)
    table = measure(truth, rate=2.0)
    if not measured:
        del table["ambient_c"]
    found = fit(tmp_path, table)
    assert_found(found, truth)
    assert found.estimates["convection_still"].value == pytest.approx(truth.convection_still, rel=0.03)
    assert found.ambient_range == pytest.approx((22.0, 26.0), abs=0.4)
    assert any("the surroundings went from 2" in remark for remark in found.remarks)


def faulty(table: Table, column: str, change: dict[int, float]) -> Table:
    values = table[column].copy()
    for at, value in change.items():
        values[at] = value
    return table | {column: values}


FAULTS = {
    "zeros of a loose thermocouple": ("temperature_c", dict.fromkeys(range(100, 103), 0.0), "3 x 0 C"),
    "an open thermocouple": ("temperature_c", dict.fromkeys(range(60, 64), 1023.75), "4 x 1024 C"),
    "spikes": ("temperature_c", {20: 150.0, 333: -40.0, 800: 95.0}, "1 x -40 C"),
    "a spike of the current": ("current_a", {20: 9.0}, "current at 4 s: 1 x 9 A"),
    "a lost current": ("current_a", {30: 0.0}, "current at 6 s: 1 x 0 A"),
    "a stuck sensor while it cools": ("temperature_c", dict.fromkeys(range(250, 275), 37.0), "25 x 37 C"),
    "zeros of the voltage": ("voltage_v", {20: 0.0, 25: 0.0}, ""),
    "zeros of the length": ("length_mm", {400: 0.0, 401: 0.0}, "length from 80 to 80.2 s: 2 x 0 mm"),
}


@pytest.mark.parametrize(
    "names", [pytest.param([*FAULTS], id="all"), *(pytest.param([n], id=n, marks=LONG) for n in FAULTS)]
)
def test_faults_of_a_sensor_are_named_and_change_nothing(
    tmp_path: Path, table: Table, clean: SpringFit, names: list[str]
) -> None:
    spoiled = table
    for column, change, _ in (FAULTS[n] for n in names):
        spoiled = faulty(spoiled, column, change)
    found = fit(tmp_path, spoiled)
    assert_found(found)
    assert all(FAULTS[n][2] in "; ".join(found.remarks) for n in names)
    assert sum(f.samples for f in found.faults) == sum(
        len(change) for _, change, words in (FAULTS[n] for n in names) if words
    )
    for constant in CONSTANTS:
        assert abs(found.estimates[constant].value - clean.estimates[constant].value) < (
            0.3 * clean.estimates[constant].margin
        ), constant


@LONG
def test_a_sensor_that_is_stuck_while_it_heats_is_named(tmp_path: Path, table: Table) -> None:
    value = table["temperature_c"][15]
    found = fit(tmp_path, faulty(table, "temperature_c", dict.fromkeys(range(15, 40), value)))
    assert_found(found)
    (fault,) = found.faults
    assert (fault.samples, fault.value) == (25, pytest.approx(value, abs=1e-3))


@LONG
def test_a_sensor_at_its_limit_is_named(tmp_path: Path, table: Table) -> None:
    clipped = table | {"temperature_c": np.minimum(table["temperature_c"], 80.0)}
    found = fit(tmp_path, clipped)
    assert_found(found)
    assert {f.value for f in found.faults} == {80.0}


@LONG
def test_lines_that_are_missing_change_nothing(tmp_path: Path, table: Table) -> None:
    keep = np.ones(len(table["t_s"]), bool)
    keep[100:200] = keep[500:505] = False
    assert_found(fit(tmp_path, {n: v[keep] for n, v in table.items()}))


@pytest.mark.parametrize(
    ("separator", "encoding"),
    [
        (",", "utf-8-sig"),
        (";", "utf-8"),
        (";", "utf-8-sig"),
        ("\t", "utf-8"),
        (",", "utf-16"),
        (";", "utf-16"),
    ],
)
def test_tables_of_spreadsheets_are_read(tmp_path: Path, table: Table, separator: str, encoding: str) -> None:
    plain = load_spring_recording(write(tmp_path / "plain.csv", table))
    other = load_spring_recording(write(tmp_path / "other.csv", table, separator, encoding))
    assert other == plain


UNIT, COLUMN, TIMES = "input.implausible", "spring.wrong-column", "spring.wrong-times"
REFUSED = {
    "Fahrenheit": ({"temperature_c": lambda t: 1.8 * t + 32}, UNIT, "temperature_c: .*Fahrenheit"),
    "kelvin": ({"temperature_c": lambda t: t + 273.15}, UNIT, "temperature_c: .* looks like kelvin"),
    "metres": ({"length_mm": lambda x: 1e-3 * x}, UNIT, "length_mm: .* looks like metres"),
    "centimetres": ({"length_mm": lambda x: 0.1 * x}, UNIT, "length_mm: .* looks like .*centimetres"),
    "milliseconds": ({"t_s": lambda t: 1e3 * t}, UNIT, "t_s: .* looks like milliseconds"),
    "minutes": ({"t_s": lambda t: t / 60}, UNIT, "t_s: .* looks like minutes"),
    "milliamperes": ({"current_a": lambda i: 1e3 * i}, UNIT, "current_a: .* looks like milliamperes"),
    "millivolts": ({"voltage_v": lambda u: 1e3 * u}, UNIT, "voltage_v: .* looks like millivolts"),
    "both in thousandths": (
        {"current_a": lambda i: 1e3 * i, "voltage_v": lambda u: 1e3 * u},
        UNIT,
        "current_a: .* looks like milliamperes",
    ),
    "a reversed clamp": ({"current_a": lambda i: -i}, "spring.current-backwards", "found -3.45 A"),
    "NaN": ({"temperature_c": lambda t: np.where(t > 80, np.nan, t)}, COLUMN, r"temperature_c; .* line \d"),
    "times out of order": ({"t_s": lambda t: np.roll(t, 3)}, TIMES, ", then "),
    "a time again": ({"t_s": lambda t: np.where(np.arange(len(t)) == 9, t[8], t)}, TIMES, "1.6 s, then 1.6"),
    "a stuck sensor": (
        {"temperature_c": lambda t: np.where(np.arange(len(t)) > 800, t[800], t)},
        "spring.faulty-samples",
        "at most 10% of .* temperature from",
    ),
    "the current of another spring": (
        {"current_a": lambda i: np.roll(i, 100), "voltage_v": lambda u: np.roll(u, 100)},
        r"spring\.(not-followed|undetermined|faulty-samples)",
        "",
    ),
}  # fmt: skip


_FITTED = ("a stuck sensor", "the current of another spring")


@pytest.mark.parametrize("name", [pytest.param(n, marks=LONG) if n in _FITTED else n for n in REFUSED])
def test_what_is_no_recording_in_these_units_is_refused(tmp_path: Path, table: Table, name: str) -> None:
    changes, code, message = REFUSED[name]
    changed = table | {column: change(table[column]) for column, change in changes.items()}
    rig, out = tmp_path / "rig.yaml", tmp_path / "measured.yaml"
    rig.write_text(rig_text())
    path = write(tmp_path / "table.csv", changed)
    words = ["calibrate", "springs", str(path), "--rig", str(rig), "--out", str(out)]
    result = CliRunner().invoke(application(words[0]), words)
    assert isinstance(result.exception, InputError), result.output
    assert re.fullmatch(code, result.exception.code), result.exception
    assert re.search(message, str(result.exception)), result.exception
    assert not out.exists()


def test_a_thermocouple_that_lags_by_two_seconds_is_refused(tmp_path: Path) -> None:
    table = measure(TRUTH, rate=2.0)
    kernel = 0.25 * np.exp(-0.25 * np.arange(32))
    lagging = 22 + np.convolve(table["temperature_c"] - 22, kernel)[: len(table["t_s"])]
    with raises(InputError, "spring.model-misfit", match="expected a residual near its noise"):
        fit(tmp_path, table | {"temperature_c": lagging})


def test_a_gap_around_a_switch_and_a_warm_start_are_refused(tmp_path: Path, table: Table) -> None:
    off = int(np.flatnonzero(np.diff(table["current_a"]) < -1)[0])
    for keep, code in (
        (np.r_[0 : off - 5, off + 6 : len(table["t_s"])], "spring.samples-missing"),
        (np.r_[30 : len(table["t_s"])], "spring.warm-start"),
    ):
        with raises(InputError, code):
            load_spring_recording(write(tmp_path / "table.csv", {n: v[keep] for n, v in table.items()}))


def test_a_result_that_no_rig_can_have_is_not_written(tmp_path: Path) -> None:
    """The fan blew all the time, and the table says that it did not."""
    table = measure(replace(TRUTH, convection_still=115.0), rate=2.0)
    rig, out = tmp_path / "rig.yaml", tmp_path / "measured.yaml"
    rig.write_text(rig_text())
    path = write(tmp_path / "table.csv", table)
    words = ["calibrate", "springs", str(path), "--rig", str(rig), "--out", str(out)]
    result = CliRunner().invoke(application(words[0]), words)
    assert isinstance(result.exception, InputError) and not out.exists()
    assert re.search(r"springs\.convection_still; .*100.* found 1", str(result.exception)), result.exception


def test_what_is_written_is_a_rig_with_these_constants(tmp_path: Path) -> None:
    table = measure(TRUTH, rate=2.0)
    del table["ambient_c"]
    rig, out = tmp_path / "rig.yaml", tmp_path / "measured.yaml"
    rig.write_text(rig_text())
    path = write(tmp_path / "table.csv", table, ";", "utf-8-sig")
    words = ["calibrate", "springs", str(path), "--rig", str(rig), "--out", str(out)]
    result = CliRunner().invoke(application(words[0]), words)
    assert result.exit_code == 0, result.exception
    assert re.search(r"residual: 0\.\d\d K .* noise of the samples: 0\.\d\d K", result.output)
    found = Rig.load(out).spring_parameters()
    assert found.heat_capacity == pytest.approx(TRUTH.heat_capacity, rel=0.02)
    assert found.convection_still == pytest.approx(TRUTH.convection_still, rel=0.03)
