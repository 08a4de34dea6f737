"""`eldir calibrate springs`: hidden springs, noise, closed forms; every interval must deserve its name."""

import csv
import re

import numpy as np
import pytest
from typer.testing import CliRunner

from eldir.errors import InputError
from eldir_app.application import application
from eldir_calibration.identification.spring_record import load_spring_recording
from eldir_calibration.springs.fit import fit_spring
from eldir_calibration.springs.recording import SpringRecording
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.sections import THERMAL
from tests.calibration.springs.spring_recordings import FORMER, recorded
from tests.hardware.rigs_and_schedules import rig_text
from tests.raised import raises


@pytest.mark.parametrize("seed", [1, *(pytest.param(s, marks=pytest.mark.stress) for s in (2, 3))])
def test_a_hidden_spring_is_found(seed):
    """Another spring, 0.3 K of noise: near the truth, within intervals that are not vain."""
    hidden = FORMER.perturb(np.random.default_rng([seed, 9]))
    fit = fit_spring(recorded(hidden, seed=seed), FORMER)
    truth = {n: getattr(hidden, n) for n in fit.estimates if hasattr(hidden, n)}
    assert {"resistance", "heat_capacity", "latent_heat", "convection_still", "convection_fan",
            "austenite_start", "austenite_finish", "martensite_start", "martensite_finish",
            "cold_length", "hot_length"} <= set(truth)  # fmt: skip
    for name, estimate in fit.estimates.items():
        if name not in truth:
            continue
        if name.endswith(("start", "finish", "ambient")):
            assert abs(estimate.value - truth[name]) < 1.0, name
            assert estimate.margin < 2.0
        else:
            assert estimate.value == pytest.approx(truth[name], rel=0.06), name
            assert estimate.margin < 0.1 * abs(estimate.value), name
    assert fit.residual == pytest.approx(0.3, rel=0.15), "the noise and nothing else"
    assert fit.unidentified == ()


def test_below_the_transformation_it_is_the_closed_form():
    """An exponential up and down, written without the heat model; what it does not tell is left alone."""
    mass_capacity, loss, ohm, current, ambient = 1.40, 0.060, 0.95, 0.8, 21.0
    tau, rise = mass_capacity / loss, current**2 * ohm / loss
    t = np.arange(0.2, 180, 0.2)
    up = ambient + rise * (1 - np.exp(-t / tau))
    peak = ambient + rise * (1 - np.exp(-60 / tau))
    temperature = np.where(t <= 60, up, ambient + (peak - ambient) * np.exp(-(t - 60) / tau))
    on = t <= 60
    noise = np.random.default_rng(1).normal(0, 0.05, len(t))
    fit = fit_spring(
        SpringRecording(t, current * on, current * ohm * on, temperature + noise, np.zeros(len(t), bool)),
        FORMER,
    )
    for name, value in (("heat_capacity_times_mass", mass_capacity), ("loss_still", loss)):
        assert fit.estimates[name].value == pytest.approx(value, rel=0.02)
    assert fit.estimates["resistance"].value == pytest.approx(ohm)
    assert {"latent_heat", "loss_fan", "austenite_start", "martensite_start"} <= set(fit.unidentified)
    assert fit.parameters.latent_heat == FORMER.latent_heat


WRONG = "spring.wrong-column"


def test_the_command_writes_a_rig_file_that_keeps_its_comments(tmp_path):
    hidden = FORMER.perturb(np.random.default_rng(7))
    data = recorded(hidden)
    table = tmp_path / "heating.csv"
    with table.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t_s", "current_a", "voltage_v", "temperature_c", "fan", "length_mm"])
        rows = zip(
            data.time, data.current, data.voltage, data.temperature, data.fan, data.length, strict=True
        )
        writer.writerows([t, i, u, c, int(f), 1e3 * x] for t, i, u, c, f, x in rows)
    rig, out = tmp_path / "rig.yaml", tmp_path / "measured.yaml"
    rig.write_text(rig_text())
    result = CliRunner().invoke(
        application("calibrate"), ["calibrate", "springs", str(table), "--rig", str(rig), "--out", str(out)]
    )
    assert result.exit_code == 0, result.exception
    assert re.search(r"residual: 0\.\d\d K .* noise of the samples: 0\.\d\d K", result.output)
    assert "heat_capacity: 4" in result.output and "+-" in result.output
    assert Rig.load(out).springs.calibrated == set(THERMAL), "limits count on what was measured"
    found = Rig.load(out).spring_parameters()
    assert found.latent_heat == pytest.approx(hidden.latent_heat, rel=0.06)
    assert found.austenite_finish == pytest.approx(hidden.austenite_finish, abs=1)
    assert "# A rig for eldir. Read docs/safety.md" in out.read_text()


@pytest.mark.parametrize(
    ("text", "code", "key", "found"),
    [
        ("", "file.empty", None, "expected columns"),
        ("\n", "spring.other-table", None, "found nothing"),
        ("t_s,current_a\n1,2\n", "spring.other-table", None, "expected columns t_s, current_a, voltage_v"),
        ("t_s,current_a,voltage_v,temperature_c,fan\n1,2,x,3,0\n", WRONG, "voltage_v", "'x'"),
        ("t_s,current_a,voltage_v,temperature_c,fan\n1,nan,1,3,0\n", WRONG, "current_a", "none in line 2"),
        (
            "t_s,current_a,voltage_v,temperature_c,fan\n1,2,3,4,1.0\n2,2,3,4,2\n",
            WRONG,
            "fan",
            r"table\.csv: .*expected 0 or 1; found 2 in line 3$",
        ),
        ("t_s,current_a,voltage_v,temperature_c,fan\n1,2,3,4,0\n", "spring.too-short", None, "20 .*found 1$"),
        (
            "t_s,current_a,voltage_v,temperature_c,fan\n" + "7,2,3,4,0\n" * 30,
            "spring.wrong-times",
            None,
            "found 7 s, then 7 s",
        ),
        ("x" * (9 << 20), "file.too-large", None, "at most 8192 KiB"),
    ],
    ids=lambda text: str(text)[-20:],
)
def test_a_table_that_is_no_recording_is_named(tmp_path, text, code, key, found):
    path = tmp_path / "table.csv"
    path.write_text(text)
    with raises(InputError, code, key, match=found):
        load_spring_recording(path)
