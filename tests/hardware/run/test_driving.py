"""From a design to a schedule, a run on the virtual rig and its log; `eldir rig` and its errors."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from eldir.built import gait_search
from eldir.built.screening import candidate_gaits
from eldir.design import marked_masses
from eldir.errors import EldirError, InputError
from eldir.lattice import Lattice
from eldir.parameters.springs import SpringParameters
from eldir_app.commands.rig import rig as rig_command
from eldir_hardware.camera.plane import Plane
from eldir_hardware.clock import WallClock
from eldir_hardware.log.reader import read_log
from eldir_hardware.planning import plan as planning
from eldir_hardware.planning.plan import PlanConfig, plan
from eldir_hardware.relay.lcus import LcusBoard
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import get_emulator
from eldir_hardware.rig.template import real_rig
from eldir_hardware.run.drive import DriveConfig, drive_rig
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.virtual.bodies import EngineBody
from tests.eldir.random_design import make_design
from tests.hardware.camera.lenses import lens_of
from tests.hardware.rigs_and_schedules import SCHEDULE, rig_text
from tests.raised import raises


@pytest.fixture(scope="module")
def design():
    return make_design(3, Lattice(3, 6))


@pytest.fixture(scope="module")
def folder(design, tmp_path_factory) -> Path:
    where = tmp_path_factory.mktemp("driving")
    design.save(where / "design.json")
    (where / "rig.yaml").write_text(rig_text(seed=4, design="design.json"))
    return where


@pytest.fixture(scope="module")
def schedule(design, folder):
    """With few phases, few samples of each time of heating, and without the margins; all have tests of
    their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gait_search, "candidate_gaits", lambda motors: candidate_gaits(motors, 2))
        patch.setattr(gait_search, "_SAMPLES", 2)
        patch.setattr(planning, "heat_margins", lambda *_: None)
        return plan(design, Rig.load(folder / "rig.yaml"), PlanConfig(imitate=True, samples=2))


def test_a_plan_says_what_it_predicts(design, schedule, folder):
    assert schedule.springs == tuple(np.flatnonzero(design.morphology.active))
    assert schedule.predicted.method == "imitate"
    assert schedule.predicted.peak_c < 90
    for method in ("search", "imitate"):
        walk = schedule.predicted.displacement[method]
        assert walk.samples == 2 and len(walk.phase) == design.morphology.motors
        assert walk.mean is None or abs(walk.mean) < 5
    json.dumps(schedule.to_json(), allow_nan=False)


def test_a_design_with_more_motors_than_the_rig_heats_is_refused(design, folder):
    one = Rig.load(folder / "rig.yaml")
    one = one.model_copy(update={"channels": one.channels[:2]})
    assert design.morphology.motors == 2
    with raises(InputError, "input.wrong-value", "number of motors", match="at most 1 "):
        plan(design, one)


def test_driving_records_everything(design, schedule, folder):
    truth = []
    short = schedule.__class__(
        schedule.period_s, events=schedule.events, cycles=1, conditioning_cycles=0, springs=schedule.springs
    )
    short = with_digests(short, Rig.load(folder / "rig.yaml"), design)
    size = (640, 480)
    lens_of(size, [700, 700], [320, 240], [0] * 5).save(folder / "camera.json")
    Plane(*size, np.eye(3), [320, 240], [0, 0], 0.1).save(folder / "plane.json")
    rig_path = folder / "calibrated.yaml"
    files = "rate_hz: 10, lens: camera.json, plane: plane.json}"
    rig_path.write_text((folder / "rig.yaml").read_text().replace("rate_hz: 10}", files))
    played = drive_rig(
        short, Rig.load(rig_path), rig_path, folder / "log.mcap", DriveConfig(on_body=truth.append)
    )
    log = read_log(folder / "log.mcap")
    for name in ("camera.json", "plane.json"):  # named in the rig file
        assert json.loads(log.attachments[name]) == json.loads((folder / name).read_text())
    assert log.frame_count == len(truth) == pytest.approx(10 * short.duration, abs=4)
    assert {"design.json", "schedule.json", "rig.yaml", "tags.json"} <= set(log.attachments)
    assert np.max(log.temperatures) == pytest.approx(played.peak_c, abs=3)
    assert np.asarray(log.relays).any() and not np.asarray(log.relays)[-1].any()
    assert "played to the end" in str(log.statuses)
    marks = marked_masses(design.morphology)
    height = np.array([f.positions[marks, 1] for f in truth])
    assert np.isfinite(height).all() and np.ptp(height, axis=0).max() > 1e-4, "the body moves"


def test_no_log_is_left_by_a_run_that_never_began(schedule, folder):
    rig = Rig.load(folder / "rig.yaml").model_copy(update={"cutoff": None})
    with raises(EldirError, "limit.stuck-contact"):
        drive_rig(schedule, rig, folder / "rig.yaml", folder / "none.mcap")
    assert not (folder / "none.mcap").exists()


def test_the_body_goes_on_from_where_it_is(design):
    """Moved in one go or in pieces, it ends at the same place."""
    lengths = np.linspace(0.025, 0.06, 40)[:, None, None] * np.ones((2, 2))
    whole, pieces = (EngineBody(design.morphology, 5, SpringParameters()) for _ in range(2))
    whole.move(lengths, 0.05)
    for part in np.split(lengths, 8):
        pieces.move(part, 0.05)
    assert np.allclose(whole.positions, pieces.positions, atol=1e-6)
    other = EngineBody(design.morphology, 6, SpringParameters())
    other.move(lengths, 0.05)
    assert not np.allclose(whole.positions, other.positions, atol=1e-6), "another specimen"


# The command.


def run(*arguments: object) -> str:
    result = CliRunner().invoke(rig_command, [str(a) for a in arguments], catch_exceptions=True)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.output


def test_new_writes_a_file_once(tmp_path):
    out = tmp_path / "rig.yaml"
    run("new", "--board", "modbus", "--port", "/dev/ttyUSB0", "--out", out)
    assert Rig.load(out).board.kind == "modbus"
    before = out.read_bytes()
    with raises(EldirError, "file.exists"):
        run("new", "--board", "virtual", "--out", out)
    assert out.read_bytes() == before
    other = tmp_path / "other.yaml"
    assert "a real board needs a serial port" in run("new", "--board", "lcus", "--out", other)
    assert "a virtual rig has no port" in run("new", "--port", "/dev/tty", "--out", other)
    assert not other.exists()


def test_off_opens_what_is_closed(tmp_path):
    emulated = get_emulator("lcus")(4, WallClock())
    port = emulated.start()
    board = LcusBoard(port, 4, WallClock())
    board.switch({1: True, 2: True})
    board.close()
    path, link = tmp_path / "rig.yaml", tmp_path / "board"
    link.symlink_to(port)
    path.write_text(real_rig("lcus", str(link)))
    assert "FAIL  board: channels 1, 2 are closed" in run("doctor", "--rig", path)
    assert "all 4 channels are open" in run("off", "--rig", path)
    assert emulated.contacts == (False,) * 4
    assert "ok    board: lcus, all open" in run("doctor", "--rig", path)
    emulated.close()
    link.unlink()  # at once another test may have a pseudo-terminal of the same number
    findings = json.loads(run("doctor", "--rig", path, "--json"))
    assert not next(f for f in findings if f["subject"] == "port")["ok"]


def test_a_log_that_is_there_is_told_before_the_rig_is_looked_at(tmp_path):
    (tmp_path / "rig.yaml").write_text(real_rig("lcus", "/dev/no-such-port"))
    (tmp_path / "log.mcap").touch()
    with raises(EldirError, "file.exists", match=r"log\.mcap"):
        drive_rig(SCHEDULE, Rig.load(tmp_path / "rig.yaml"), tmp_path / "rig.yaml", tmp_path / "log.mcap")
