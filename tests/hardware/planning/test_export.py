"""`eldir export`: the robot as a file that MuJoCo opens, written without MuJoCo."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

from eldir.errors import EldirError, InputError
from eldir.lattice import Lattice
from eldir.parameters.springs import SpringParameters
from eldir_app.application import application
from eldir_cad.kit.printer import Printer, load_printer
from eldir_cad.kit.specification import Specification, kit_file, load_specification
from eldir_cad.multibody.biplane import build_biplane
from eldir_cad.multibody.model import build_multibody
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.planning.model_export import ROW_INTERVAL, free_lengths
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.virtual.biplane_body import BiplaneMotion
from eldir_hardware.virtual.mujoco_body import MujocoMotion
from tests.eldir.random_design import make_design
from tests.hardware.rigs_and_schedules import gait, rig_with
from tests.raised import raises

mujoco = pytest.importorskip("mujoco")  # installed with the extra `test`
DESIGN = make_design(3, Lattice(3, 6))


def parts() -> tuple[Specification, Printer]:
    return load_specification(), load_printer("xip")


@pytest.fixture(scope="module")
def schedule() -> ActuationSchedule:
    """One heating of both springs."""
    springs = tuple(np.flatnonzero(DESIGN.morphology.active).tolist())
    whole = compile_schedule(gait(period=15.0, duty=(0.27, 0.27)), rig_with(), springs=springs)
    return ActuationSchedule(
        whole.period_s,
        events=whole.events,
        cycles=1,
        conditioning_cycles=0,
        settle_s=0.5,
        springs=whole.springs,
    )


@pytest.fixture(scope="module")
def folder(schedule: ActuationSchedule, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the command wrote, in an interpreter in which mujoco cannot be imported."""
    where = tmp_path_factory.mktemp("export")
    DESIGN.save(where / "design.json")
    schedule.save(where / "schedule.json")
    code = "import sys; sys.modules['mujoco'] = None; from eldir_app.main import main; main()"
    arguments = ["export", "design.json", "--schedule", "schedule.json", "--out", "robot.xml"]
    subprocess.run([sys.executable, "-c", code, *arguments], cwd=where, check=True, capture_output=True)
    return where


def test_mujoco_compiles_the_model(folder: Path) -> None:
    model = mujoco.MjModel.from_xml_path(str(folder / "robot.xml"))
    hubs = len(DESIGN.morphology.positions)
    assert model.nbody == hubs + 1 and model.nu == DESIGN.morphology.motors
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC and model.opt.impratio >= 100
    assert model.nmesh == hubs + 1, "the shapes of all hubs, and the hexagon that touches the table"
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("standing").id)
    mujoco.mj_step(model, data, 2000)
    assert np.abs(data.qpos.reshape(-1, 3)[:, :2]).max() < 3e-3, "it stands"


def test_shapes_are_where_the_hubs_are(folder: Path) -> None:
    files = sorted((folder / "robot-parts").iterdir())
    assert len(files) == len(DESIGN.morphology.positions)
    for file in files:
        shape = trimesh.load_mesh(file)
        assert np.abs(shape.bounds.mean(axis=0)).max() < 2e-4, "centred on the hub"
        assert 0.0119 < np.ptp(shape.bounds[:, 0]) < 0.0122 and 0.049 < np.ptp(shape.bounds[:, 1]) < 0.051


def test_the_runner_moves_the_robot_as_the_rig_does(folder: Path, schedule: ActuationSchedule) -> None:
    subprocess.run([sys.executable, "robot-run.py"], cwd=folder, check=True, capture_output=True)
    rows = np.loadtxt(folder / "robot-motion.csv", delimiter=",", skiprows=1)
    model = build_multibody(DESIGN.morphology, *parts())
    springs = SpringParameters(current_limit=3.6)  # of the parts, and of a new rig file
    motion = MujocoMotion(model, (springs.cold_length, springs.hot_length))
    motion.follow(free_lengths(schedule, springs, len(model.coils)).mean(axis=2), ROW_INTERVAL)
    assert rows[-1, 0] == pytest.approx(schedule.duration)
    ended, expected = rows[-1, 1:].reshape(-1, 2), motion.positions
    # The shape to a few micrometres; where feet slip, the last digit of a length moves the whole by 0.3 mm.
    assert ended - ended.mean(axis=0) == pytest.approx(expected - expected.mean(axis=0), abs=2e-5)
    assert ended.mean(axis=0) == pytest.approx(expected.mean(axis=0), abs=1e-3)
    assert np.ptp(rows[:, 1:], axis=0).max() > 5e-3


def test_a_model_with_both_faces_stands_and_moves_as_that_of_the_rig(folder: Path, tmp_path: Path) -> None:
    """The heating of the front alone, in its first two seconds."""
    given = [str(folder / "design.json"), "--schedule", str(folder / "schedule.json"), "--dimensions", "3"]
    result = CliRunner().invoke(
        application("export"), ["export", *given, "--out", str(tmp_path / "robot.xml")]
    )
    assert result.exit_code == 0, result.output
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("standing").id)
    mujoco.mj_step(model, data, 1000)
    assert np.abs(data.qpos.reshape(-1, 6)[:, :3]).max() < 3e-3, "it stands"
    faces, motors = ("front", "back"), DESIGN.morphology.motors
    assert [model.actuator(i).name for i in range(model.nu)] == [
        f"coil_{motor}_{face}" for motor in range(motors) for face in faces
    ]
    table = tmp_path / "robot-schedule.csv"
    rows = np.loadtxt(table, delimiter=",", skiprows=1)[40:81]
    rows[:, 0] -= rows[0, 0]
    rows[:, 2::2] = np.loadtxt(table, delimiter=",", skiprows=1)[0, 2::2]  # the back stays cold
    np.savetxt(table, rows, delimiter=",", header=table.read_text().split("\n")[0], comments="")
    subprocess.run([sys.executable, "robot-run.py"], cwd=tmp_path, check=True, capture_output=True)
    moved = np.loadtxt(tmp_path / "robot-motion.csv", delimiter=",", skiprows=1)[-1, 1:].reshape(-1, 3)
    springs, biplane = SpringParameters(current_limit=3.6), build_biplane(DESIGN.morphology, *parts())
    motion = BiplaneMotion(biplane, (springs.cold_length, springs.hot_length))
    between = np.diff(rows[:, 1 : 1 + 2 * motors], axis=0)
    assert np.ptp(between) > 0, "something is heated"
    centres = rows[:, 1 : 1 + 2 * motors] + 2 * biplane.plane.socket
    motion.follow(centres, ROW_INTERVAL)
    expected = motion.discs.mean(axis=1)
    assert moved == pytest.approx(expected, abs=3e-4)
    assert np.abs(moved[:, 1]).max() > 2e-4, "faces that are heated unlike leave the plane"


def test_own_coils_are_those_of_the_parts_file(folder: Path, tmp_path: Path) -> None:
    """Softer by the third power of their diameter, and slower: half the current, a quarter of the heat."""
    text = kit_file("parts.yaml").read_text().replace("outer_diameter: 7.25", "outer_diameter: 9.0")
    (tmp_path / "parts.yaml").write_text(text.replace("current_limit_a: 3.6", "current_limit_a: 1.8"))
    given = [str(folder / "design.json"), "--schedule", str(folder / "schedule.json")]
    options = ["--parts", str(tmp_path / "parts.yaml"), "--out", str(tmp_path / "robot.xml")]
    result = CliRunner().invoke(application("export"), ["export", *given, *options])
    assert result.exit_code == 0, result.output
    own, usual = (
        np.loadtxt(where / "robot-schedule.csv", delimiter=",", skiprows=1) for where in (tmp_path, folder)
    )
    motors = DESIGN.morphology.motors
    lengths, stiffness = slice(1, 1 + motors), slice(1 + motors, None)
    np.testing.assert_allclose(own[0, stiffness], usual[0, stiffness] * (6.5 / 8.25) ** 3)
    np.testing.assert_array_equal(own[0, lengths], usual[0, lengths])
    assert (own[:, lengths].max(axis=0) < usual[:, lengths].max(axis=0) - 5e-3).all()


def test_the_same_design_gives_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(
        application("export"), ["export", str(folder / "design.json"), "--out", str(tmp_path / "robot.xml")]
    )
    assert result.exit_code == 0, result.output
    assert result.output.splitlines() == [f"wrote {tmp_path / name}" for name in ("robot.xml", "robot-parts")]
    assert (tmp_path / "robot.xml").read_bytes() == (folder / "robot.xml").read_bytes()
    assert not (tmp_path / "robot-run.py").exists()
    ElementTree.fromstring((tmp_path / "robot.xml").read_text())


def test_a_schedule_for_another_rig_is_refused(
    folder: Path, schedule: ActuationSchedule, tmp_path: Path
) -> None:
    own, other = rig_with(), rig_with(supply={"current_limit_a": 3.0})
    heating, rig, out = (tmp_path / name for name in ("schedule.json", "rig.yaml", "robot.xml"))
    with_digests(schedule, own, DESIGN).save(heating)
    given = [str(folder / "design.json"), "--schedule", str(heating), "--rig", str(rig), "--out", str(out)]
    rig.write_bytes(other.source)
    with raises(InputError, "schedule.other-rig", match="rig.yaml: the rig file has other values in supply"):
        CliRunner().invoke(application("export"), ["export", *given], catch_exceptions=False)
    assert not out.exists()
    rig.write_bytes(own.source)
    assert CliRunner().invoke(application("export"), ["export", *given]).exit_code == 0


def test_nothing_is_overwritten_and_other_formats_are_refused(folder: Path, tmp_path: Path) -> None:
    again = CliRunner().invoke(
        application("export"), ["export", str(folder / "design.json"), "--out", str(folder / "robot.xml")]
    )
    assert isinstance(again.exception, EldirError) and "exists already" in str(again.exception)
    urdf = CliRunner().invoke(
        application("export"), ["export", str(folder / "design.json"), "--out", str(tmp_path / "a.urdf")]
    )
    assert urdf.exit_code == 2
