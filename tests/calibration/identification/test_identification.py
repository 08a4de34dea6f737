"""From a log to an identified scene: what is read of it, and what the command tells."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from eldir.built.gait import FilmedGait, Gait
from eldir.built.robot import build
from eldir.built.scene import PrintedScene
from eldir.design import Design
from eldir.errors import EldirError, InputError
from eldir.lattice import Lattice
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir.trajectory import Trajectory
from eldir_app.commands.calibrate.dynamics import dynamics
from eldir_calibration.comparison.motions import prepare_report
from eldir_calibration.comparison.recorded_run import MeasuredConditions, open_run
from eldir_calibration.dynamics._problem import compute_residual
from eldir_calibration.dynamics.recording import FilmedBody, Measurements, Recording, predict_markers
from eldir_calibration.identification import identification
from eldir_calibration.identification.identification import read_filmed_gait, read_films, read_recording
from eldir_hardware.log.mcap_file import fingerprint
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.run.drive import drive_rig
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.virtual.bodies import far_robot
from tests.calibration.dynamics.hidden_rigs import heating
from tests.eldir.random_design import make_design
from tests.hardware.rigs_and_schedules import rig_text
from tests.paths import SCHEMAS
from tests.raised import raises

SCHEMA = json.loads((SCHEMAS / "built-scene.schema.json").read_text())


@pytest.fixture
def log(recording: Recording, tmp_path: Path) -> Path:
    return write_log(recording, tmp_path)


def write_log(recording: Recording, tmp_path: Path, sensor: str | None = None) -> Path:
    """A log as the recorder of a run writes it, with tracks instead of pictures; in the pulses of a rig with
    a `sensor` springs get hot at 3.7 A and 3.6 V."""
    design = Design.from_json(make_design(3, Lattice(3, 6)).to_json())
    design.save(tmp_path / "design.json")
    (tmp_path / "rig.yaml").write_text(rig_text(seed=4, design="design.json"))
    if sensor is not None:
        text = (tmp_path / "rig.yaml").read_text()
        (tmp_path / "rig.yaml").write_text(f"{text}sensor: {{kind: {sensor}}}\n")
    rig = Rig.load(tmp_path / "rig.yaml")
    gait = Gait(20.0, np.array([0.0, 0.875]), np.full(2, 0.3))
    springs = tuple(np.flatnonzero(design.morphology.active).tolist())
    schedule = compile_schedule(gait, rig, springs, cycles=2)
    names = [f"m{i + 1}" for i in range(len(design.marks))]
    channels, named = [f"channel{i}" for i in range(1, 5)], [f"spring{i}" for i in range(4)]
    with Recorder(tmp_path / "log.mcap", channels, named) as recorder:
        recorder.attach("schedule.json", json.dumps(schedule.to_json()).encode())
        recorder.attach("rig.yaml", (tmp_path / "rig.yaml").read_bytes())
        recorder.attach("design.json", json.dumps(design.to_json()).encode())
        recorder.on_relays(0.0, [False] * 4)
        state = dict.fromkeys(range(1, 5), False)
        for t, changes in schedule.switchings():
            state |= changes
            recorder.on_relays(t, list(state.values()))
            for later in (1.0, 1.1) if sensor is not None else ():
                on = np.array(list(state.values()))
                recorder.on_relays(t + later, list(state.values()))
                recorder.on_temperatures(t + later, np.where(on, 61.0, 30.0))
                recorder.on_currents(t + later, np.where(on, 3.7, 0.0), np.where(on, 3.6, 0.0))
        for t, marks in zip(recording.tracked.times, recording.tracked.positions, strict=True):
            recorder.on_tracks(t, names, marks[: len(names)])
    return tmp_path / "log.mcap"


def test_a_log_becomes_a_recording(log: Path, recording: Recording) -> None:
    design = Design.load(log.parent / "design.json")
    found = read_recording(open_run(log, design))
    assert (found.start, found.period, found.cycles) == (23.0, 20.0, 2)
    seen = recording.tracked.positions[:, : len(design.marks)]
    assert np.allclose(found.tracked.positions, seen, equal_nan=True)
    # A schedule begins with all contacts open, a gait in the middle of a period.
    assert (
        np.abs(found.contact_shares - heating(2))[round(23 / 0.05) :].max() < 1e-6
        and not found.contact_shares[:60].any()
    )
    with raises(InputError, "log.other-design"):
        open_run(log, make_design(4, Lattice(3, 6)))


def test_each_film_is_predicted_in_its_own_air(log: Path) -> None:
    """As springs in that air would move the robot; without a measured air in that of the rig file."""
    design = Design.load(log.parent / "design.json")
    run, body = open_run(log, design), FilmedBody(design.morphology, design.marks)
    films = [read_recording(replace(run, measured=MeasuredConditions(room))) for room in (None, 27.0)]
    assert [film.room_c for film in films] == [None, 27.0] and films[1].truncate(40.0).room_c == 27.0
    nominal = RobotParameters.nominal(run.rig.spring_parameters())
    warm = replace(nominal, springs=replace(nominal.springs, ambient=27.0))
    usual, in_warm_air = (x[0] for x in predict_markers(body, films, [nominal]))
    expected = predict_markers(body, films[:1], [warm])[0][0]
    np.testing.assert_array_equal(in_warm_air, expected)
    assert np.abs(in_warm_air - usual).max() > 1e-3


def test_a_film_does_not_count_twice(log: Path) -> None:
    """Neither under another name nor as the bag that it is."""
    design = Design.load(log.parent / "design.json")
    copy = log.with_name("copy.mcap")
    copy.write_bytes(log.read_bytes())
    for twice in ((log, log), (log, copy), (log, log.parent)):
        words = "is named twice" if twice[1] == log else f"holds the same film as {log}"
        with raises(InputError, "log.named-twice", match=f"{twice[1]} {words};"):
            read_films(twice, design)
        with raises(InputError, "log.named-twice"):
            prepare_report(twice, design, None)  # type: ignore[arg-type]  # before anything is predicted
    with raises(InputError, "file.missing", match=r"none\.mcap"):
        read_films([log, log.with_name("none.mcap")], design)


def test_a_paused_run_is_not_identified_from(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    design = Design.load(log.parent / "design.json")
    run = open_run(log, design)
    paused = replace(run, log=replace(run.log, statuses=((30.0, "player", "paused in cycle 2"),)))
    monkeypatch.setattr(identification, "open_runs", lambda paths, design: [paused])
    with raises(InputError, "adapt.paused", match=r"paused at 30\.0 s.*film the run again"):
        read_films([log], design)


def test_what_the_camera_saw_of_a_gait_is_kept(log: Path, recording: Recording) -> None:
    """Against the marks' places at both ends of the cycles; marks that lie on their side have fallen."""
    design = Design.load(log.parent / "design.json")
    films = read_films([log], design)
    (seen,) = films.filmed_gaits
    assert films.provenance["fingerprints"] == [fingerprint(log)]
    marks = recording.tracked.positions[:, : len(design.marks), 0]
    ends = [np.nanmean(marks[np.abs(recording.tracked.times - t) < 1.0]) for t in (23.0, 63.0)]
    walked = (ends[1] - ends[0]) / build(design.morphology).body_length * 5 / 2
    assert seen.walked == pytest.approx(walked, rel=0.06) and seen.log == "log.mcap"
    assert films.design.body == design.body
    driven = open_run(log, design)
    rest = driven.robot.positions[design.marks]
    for turn, upright in ((0.0, True), (np.pi / 2, False)):
        turned = np.tile(rest @ [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]], (600, 1, 1))
        lying = Trajectory(driven.names, 0.2 * np.arange(600), turned)
        found = read_filmed_gait(driven, replace(films.recordings[0], tracked=lying))
        assert found is not None and found.upright == upright


def test_a_gait_has_the_cycles_in_which_its_walk_is_known(log: Path) -> None:
    """Nobody is seen at the end of the second cycle, and then at no end of a cycle."""
    driven = open_run(log, Design.load(log.parent / "design.json"))
    whole = read_recording(driven)
    t, x = whole.tracked.times, whole.tracked.positions.copy()

    def filmed(unseen: np.ndarray) -> FilmedGait | None:
        x[unseen] = np.nan
        return read_filmed_gait(driven, replace(whole, tracked=replace(whole.tracked, positions=x)))

    both, first = read_filmed_gait(driven, whole), filmed(np.abs(t - whole.end) < 3.0)
    assert both is not None and first is not None and (both.cycles, first.cycles) == (2, 1)
    assert filmed(np.abs(t - whole.start) < 3.0) is None


def test_the_command_says_what_is_known_and_what_not(
    log: Path, scene: PrintedScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: dict[str, Any] = {}

    def fitted(body: object, recordings: list[Recording], nominal: object, **options: object) -> PrintedScene:
        asked.update(options, cycles=[r.cycles for r in recordings])
        return scene

    monkeypatch.setattr("eldir_calibration.identification.identification.identify_robot", fitted)
    out = log.parent / "scene.json"
    call = [str(log), "--design", str(log.parent / "design.json"), "--out", str(out), "--weight", "80"]
    call += ["--current", "3.6", "--voltage", "3.5"]
    app = typer.Typer()
    app.command()(dynamics)
    ran = CliRunner().invoke(app, call)
    assert ran.exit_code == 0, ran.output
    assert "these logs do not determine: " in ran.output and "held-out cycle" in ran.output
    assert asked["measurements"] == Measurements(pytest.approx(0.040), 3.6, 3.5) and asked["cycles"] == [2]
    assert [other.printed.joints for other in asked["others"]] == ["hubs", "clamped"]
    jsonschema.validate(json.loads(out.read_text()), SCHEMA)
    found = PrintedScene.load(out)
    assert found.body == Design.load(log.parent / "design.json").body and not len(found.ballast_kg)
    assert replace(found, body=None, filmed_gaits=()) == scene
    (film,) = found.filmed_gaits
    assert (film.gait.period, film.gait.phase.tolist(), film.cycles) == (20, [0, 0.875], 2)
    assert film.gait.duty.tolist() == [0.3, 0.3]
    assert f"filmed in log.mcap: {film.walked:+.2f} body lengths" in ran.output
    again = CliRunner().invoke(app, call)
    assert isinstance(again.exception, EldirError) and "exists already" in str(again.exception)


def test_the_sensor_takes_the_place_of_the_meters(
    recording: Recording, scene: PrintedScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Options replace what the log holds; two good meters need no sensor."""
    log = write_log(recording, tmp_path, "ina226")
    asked: list[Measurements] = []

    def fitted(*_: object, measurements: Measurements, **options: object) -> PrintedScene:
        asked.append(measurements)
        return scene

    monkeypatch.setattr("eldir_calibration.identification.identification.identify_robot", fitted)
    app = typer.Typer()
    app.command()(dynamics)
    call = [str(log), "--design", str(tmp_path / "design.json"), "--out"]
    for number, (options, said) in enumerate(
        (
            ([], "measured in the logs: 3.700 A and 3.600 V at hot springs, 12 pulses, known to 0.7%"),
            (["--current", "3.5"], "0.7%; not used: current, given as options"),
            (["--current", "3.5", "--voltage", "3.4"], "not used: current and voltage"),
        )
    ):
        ran = CliRunner().invoke(app, [*call, str(tmp_path / f"{number}.json"), *options])
        assert ran.exit_code == 0, ran.output
        assert said in " ".join(ran.output.split())
    error = pytest.approx(0.0066, abs=1e-4)
    approx = [pytest.approx(x) for x in (3.7, 3.6)]
    assert asked == [
        Measurements(None, *approx, error),
        Measurements(None, 3.5, approx[1], error),
        Measurements(None, 3.5, 3.4, None),
    ]


def test_a_film_and_a_prediction_of_the_very_same_robot_agree(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Contacts, springs, body, picture, marks on one side; the truth, which no identification knows, on the
    other. A contact's time wrong by its read-back, half a second, would leave centimetres."""
    # The springs of both faces are alike, as the model has them.
    monkeypatch.setattr(SpringParameters, "perturb", lambda spring, *_: spring)
    design = make_design(3, Lattice(3, 6))
    design.save(tmp_path / "design.json")
    text = rig_text(seed=4, design="design.json").replace("seed: 4", "seed: 4\n  parameter_spread: large")
    text = text.replace("rate_hz: 10", "rate_hz: 3")
    (tmp_path / "rig.yaml").write_text(text)
    rig = Rig.load(tmp_path / "rig.yaml")
    gait = Gait(20.0, np.array([0.0, 0.875]), np.full(2, 0.25))
    schedule = with_digests(compile_schedule(gait, rig, (7, 12), cycles=1), rig, design)
    drive_rig(schedule, rig, tmp_path / "rig.yaml", tmp_path / "log.mcap")
    film, body = (
        read_recording(open_run(tmp_path / "log.mcap", design)),
        FilmedBody(design.morphology, design.marks),
    )
    nominal = RobotParameters(springs=rig.spring_parameters())
    (x,) = predict_markers(body, [film], [nominal, true_robot(design, rig)])[0][1:]
    left = compute_residual(film, film.tracked.positions - x).shape
    off = compute_residual(
        film, film.tracked.positions - predict_markers(body, [film], [nominal])[0][0]
    ).shape
    assert left.std() < 0.1e-3 and np.abs(left).max() < 1e-3
    assert off.std() > 50 * left.std(), "the robot differs from the drawing"


def true_robot(design: Design, rig: Rig) -> RobotParameters:
    """What the virtual rig's seed makes of a design."""
    seed = rig.virtual.seed
    far = far_robot(rig)
    straight = build(design.morphology, far)
    robot = build(design.morphology, far.printed, rng=np.random.default_rng([seed, 2]))
    springs = rig.spring_tolerances().perturb_by_seed(far.springs, seed)
    return replace(far, springs=springs, strips=robot.rest_lengths - straight.rest_lengths)
