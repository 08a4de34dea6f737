"""`eldir transfer`: predictions against MuJoCo, from design files to a page."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from threading import Event

import jsonschema
import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

from eldir.built.gait import Gait, free_lengths, read_gait
from eldir.built.samples import NominalRobots, SampledWalks
from eldir.design import Design
from eldir.errors import EldirError, InputError, MissingDependencyError
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.tolerances import RigTolerances
from eldir_app.application import application
from eldir_cad.multibody.model import CoilSpring
from eldir_calibration.transfer import mujoco_walks
from eldir_calibration.transfer.compared_walks import (
    TransferConfig,
    WalkingDesign,
    compare_walks,
    count_steps,
    load_walking_design,
    robot_seeds,
    shift_phases,
)
from eldir_calibration.transfer.mujoco_walks import MujocoWalk, measure_walk, sample_heating
from eldir_hardware.planning.workshop import make_workshop
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.virtual.mujoco_body import MujocoMotion, sample_multibody
from tests.calibration.dynamics.hidden_rigs import walker
from tests.calibration.transfer.made_up_walks import FALL, GAIT, tiny_design, written_gait
from tests.hardware.virtual.multibody_models import FREE, hub, robot, small, walk
from tests.paths import SCHEMAS
from tests.raised import raises

mujoco = pytest.importorskip("mujoco")  # installed with the extra `test`
SCHEMA = json.loads((SCHEMAS / "transfer.schema.json").read_text())
SHORT = Gait(1.0, GAIT.phase, np.full(2, 0.5))
"""MuJoCo takes seconds for each second."""
DESIGN = tiny_design(written_gait(SHORT))
SMALL = ("--samples", "2", "--cycles", "1", "--dimensions", "2")


def transfer(*arguments: object) -> Result:
    return CliRunner().invoke(application("transfer"), ["transfer", *map(str, arguments)])


def refused(*arguments: object) -> str:
    """The line that the command ends with."""
    error = transfer(*arguments).exception
    assert isinstance(error, EldirError), error
    return str(error)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small run on one design, with an explanation."""
    where = tmp_path_factory.mktemp("transfer")
    DESIGN.save(where / "tiny.json")
    found = transfer(where / "tiny.json", *SMALL, "--explain", "--seed", 4, "--out", where / "out")
    assert found.exit_code == 0, found.output
    (where / "said").write_text(found.output)
    return where


def test_a_small_run_writes_one_page_and_every_number(folder: Path) -> None:
    assert sorted(p.name for p in (folder / "out").iterdir()) == ["transfer.html", "transfer.json"]
    values = json.loads((folder / "out" / "transfer.json").read_text())
    jsonschema.validate(values, SCHEMA)
    (one,) = values["walks"]
    assert len(one["predicted"]["walks"]) == len(one["mujoco"]["walks"]) == 2
    assert one["gait"]["phase"] == [0.0, 0.125] and one["mujoco"]["seeds"] == [5, 6]
    assert values["second_engine"] == f"MuJoCo {mujoco.__version__}"
    (explained,) = values["explained"]
    assert explained["seed"] == 5 and len(explained["without"]) == 6
    page = (folder / "out" / "transfer.html").read_text()
    said = (folder / "said").read_text()
    for sentence in values["verdict"]["in_words"]:
        assert sentence in said and sentence.replace("'", "&#39;") in page
    assert page.index("<h2>Verdict") < page.index("<img") < page.index("<h2>Designs")
    assert "http" not in page and "<script" not in page, "it stands alone"


def test_the_springs_are_those_of_evolution_or_of_the_rig(folder: Path, tmp_path: Path, monkeypatch) -> None:
    seen: list[SpringParameters] = []

    def reading(file: str, springs: SpringParameters, say: object) -> None:
        seen.append(springs)
        raise EldirError("read enough")

    monkeypatch.setattr("eldir_calibration.transfer.compared_walks.load_walking_design", reading)
    rig = tmp_path / "rig.yaml"
    assert CliRunner().invoke(application("rig"), ["rig", "new", "--out", str(rig)]).exit_code == 0
    for springs in ((), ("--rig", rig)):
        assert refused(folder / "tiny.json", *springs, "--out", tmp_path / "out") == "read enough"
    assert seen == [make_workshop().springs, Rig.load(rig).spring_parameters()]


def test_the_same_seed_gives_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    found = transfer(folder / "tiny.json", *SMALL, "--explain", "--seed", 4, "--out", again)
    assert found.exit_code == 0, found.output
    for name in ("transfer.json", "transfer.html"):
        assert (again / name).read_bytes() == (folder / "out" / name).read_bytes(), name


def test_another_seed_gives_other_robots_in_both_simulations(folder: Path) -> None:
    (before,) = json.loads((folder / "out" / "transfer.json").read_text())["walks"]
    settings = TransferConfig(samples=2, cycles=1, seed=40, springs=make_workshop().springs)
    (other,) = compare_walks([load_walking_design(str(folder / "tiny.json"), settings.springs)], settings)
    for walks, key in ((other.predicted, "predicted"), (other.mujoco, "mujoco")):
        assert np.isfinite(walks.displacement).all()
        # In cycles of a second robots hardly walk; the file has nine decimals.
        assert np.abs(walks.displacement - before[key]["walks"]).max() > 1e-8, key


def test_robots_in_mujoco_are_none_of_the_samples() -> None:
    settings = TransferConfig(samples=4, seed=3)
    body = DESIGN.morphology
    samples, others = (NominalRobots(body, RobotParameters()).samples(4, seed) for seed in (3, 4))
    assert {s.printed.friction for s in samples}.isdisjoint(s.printed.friction for s in others)
    taken = {round(s.printed.friction * f, 9) for s in samples for f in s.feet}
    seeds = [seed for number in (0, 1) for seed in robot_seeds(number, settings)]
    assert len(set(seeds)) == 8
    for seed in seeds:
        assert taken.isdisjoint(round(h.friction, 9) for h in sample_multibody(body, seed).hubs)


def test_a_walk_in_mujoco_is_measured_as_the_engine_measures() -> None:
    """Forward motion of the mean over the counted cycle, as the comparison of both physics measured it."""
    body = DESIGN.morphology
    table = free_lengths(replace(SHORT, period=2.0), cycles=1)
    model = robot(body)
    found = measure_walk(model, body, table, 1, SpringParameters()).displacement
    assert found == pytest.approx(walk(model, table, 1)[0], abs=1e-9) and abs(found) > 1e-3
    assert (SpringParameters().cold_length, SpringParameters().hot_length) == FREE


def test_motors_follow_the_mean_of_two_springs_that_the_seed_gives() -> None:
    springs = SpringParameters()
    nominal = free_lengths(GAIT, springs, 1).lengths
    one, same, other = (sample_heating(GAIT, seed, springs, 1).lengths for seed in (1, 1, 2))
    assert one.shape == nominal.shape and np.array_equal(one, same) and not np.allclose(one, other)
    assert 1e-5 < np.abs(one - nominal)[0].max() < 2e-3
    drawn = np.random.default_rng([1, 3])
    cold = [springs.perturb(drawn).cold_length for _ in range(4)]
    assert one[0] == pytest.approx([np.mean(cold[:2]), np.mean(cold[2:])])


def test_heat_passes_between_the_springs_of_each_face() -> None:
    springs = SpringParameters(neighbour_conductance=0.02)
    hubs = np.array([[0, 1], [1, 2]])
    found = sample_heating(GAIT, 1, springs, 1, hubs).lengths
    drawn = np.random.default_rng([1, 3])
    own = [springs.perturb(drawn) for _ in range(4)]  # front and back of the first motor, then of the second
    front, back = (free_lengths(GAIT, own[face::2], 1, hubs=hubs).lengths for face in (0, 1))
    assert np.array_equal(found, np.stack([front, back]).mean(axis=0))


@pytest.mark.parametrize("fault", ["turns over", "folds", "buckles a coil"])
def test_what_falls_folds_or_buckles_does_not_walk(fault: str) -> None:
    body = walker().morphology
    table = free_lengths(GAIT, cycles=1)
    rest = robot(body)
    places = np.array([hub.position for hub in rest.hubs])
    seconds = len(table.lengths) // 20 + 1
    path = np.repeat(places[None], seconds, axis=0)
    path[-1] += [0.1, 0.0]
    measured = mujoco_walks.evaluate_walk
    loads = np.zeros((seconds - 1, 2))
    cold = replace(table, lengths=np.full_like(table.lengths, FREE[0]))
    assert measured(body, path, loads, cold, 1).displacement == pytest.approx(5 * 0.1 / np.ptp(places[:, 0]))
    if fault == "turns over":
        path[5] = path[5] @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    elif fault == "folds":
        path[5] *= [1.0, -1.0]
    else:
        loads[4, 1] = 0.99
        assert not measured(body, path, loads, cold, 1).fault
        loads[4, 1] = 1.01
    assert measured(body, path, loads, cold, 1) == MujocoWalk(FALL, fault)


def test_coils_are_measured_between_their_hinges() -> None:
    """Between two hubs, heavy so that they stay, one of which is turned: the distance of its centres says
    too little."""
    heavy = [hub(x, mass=1e6, inertia=1e6) for x in (0.0, 0.05)]
    coils = [CoilSpring((0, 1), (98.0, 248.0), 1.0)]
    motion = MujocoMotion(small(heavy, coils=coils, socket=3.7e-3, corner=7e-3, max_rotation=0.2), FREE)
    motion.data.qpos.reshape(2, 3)[:, 1] = 0.1  # above the table
    motion.data.qpos[2] = 0.5
    motion.follow(np.full((2, 1), 0.06), 0.05)
    hinge = 3.7e-3 * np.array([np.cos(0.5), np.sin(0.5)])
    between = np.linalg.norm(np.array([0.05 - 3.7e-3, 0.0]) - hinge)
    assert motion.coil_lengths == pytest.approx([between], abs=1e-6) and between > 0.05 - 2 * 3.7e-3


def test_a_simulation_that_fails_counts_as_a_fall(monkeypatch: pytest.MonkeyPatch) -> None:
    def blown(*_: object) -> None:
        raise EldirError("the virtual robot's body blew up")

    monkeypatch.setattr(mujoco_walks.MujocoMotion, "follow", blown)
    body = DESIGN.morphology
    table = free_lengths(GAIT, cycles=1)
    assert measure_walk(robot(body), body, table, 1, SpringParameters()) == MujocoWalk(FALL, "fails")


def test_other_phases_go_round_the_period() -> None:
    found = shift_phases(GAIT, 3)
    assert [g.phase.tolist() for g in found] == [[0.0, 0.375], [0.0, 0.625], [0.0, 0.875]]
    alone = replace(GAIT, phase=np.zeros(1), duty=np.array([0.3]))
    assert shift_phases(alone, 3) == []


def test_a_gait_comes_from_the_file_or_from_all_phases(tmp_path: Path) -> None:
    DESIGN.save(tmp_path / "with.json")
    tiny_design({}).save(tmp_path / "without.json")
    said: list[str] = []
    found = load_walking_design(str(tmp_path / "with.json"), SpringParameters(), said.append)
    assert found.gait == SHORT and not found.screened and not said
    tried = load_walking_design(str(tmp_path / "without.json"), SpringParameters(), said.append)
    assert tried.screened and len(tried.gait.phase) == 2 and said and read_gait(tried.design) is None


def test_every_robot_of_every_gait_is_driven_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gaits of a design have the same robots, designs have others; springs come from the settings."""
    springs = replace(SpringParameters(), supply_voltage=5.0)
    tolerances = RigTolerances(current=0.02)
    settings = TransferConfig(3, 1, 2, 10, springs=springs, tolerances=tolerances)
    driven: list[tuple[str, tuple[float, ...], int]] = []

    def predicted(robots: NominalRobots, gaits: list[Gait], n: int, seed: int) -> list[SampledWalks]:
        assert (n, seed, robots.robot.springs, robots.tolerances) == (3, 10, springs, tolerances)
        return [SampledWalks(np.full(n, 0.1 * k)) for k in range(len(gaits))]

    def drawn(
        design: Design,
        gait: Gait,
        seed: int,
        nominal: SpringParameters,
        allowed: RigTolerances,
        cycles: int,
        ended: Event,
    ) -> MujocoWalk:
        assert nominal is springs and allowed is tolerances and cycles == 1 and not ended.is_set()
        driven.append((design.provenance["name"], tuple(gait.phase), seed))
        return MujocoWalk(-np.inf, "folds") if seed == 12 else MujocoWalk(float(seed))

    monkeypatch.setattr("eldir_calibration.transfer.compared_walks.sample_walks", predicted)
    monkeypatch.setattr("eldir_calibration.transfer.compared_walks.walk_sampled_robot", drawn)
    designs = [WalkingDesign(n, tiny_design({"name": n}), GAIT, False) for n in ("a", "b")]
    done: list[float] = []
    found = compare_walks(designs, settings, lambda _, more: done.append(more))
    assert sum(done) == count_steps(designs, settings) == 2 * (1 + 3 * 3)
    phases = [(0.0, 0.125), (0.0, 0.125 + 1 / 3), (0.0, 0.125 + 2 / 3)]
    seeds = {"a": (11, 12, 13), "b": (14, 15, 16)}
    wanted = [(n, pytest.approx(p), s) for n in "ab" for p in phases for s in seeds[n]]
    assert sorted(driven, key=lambda d: (d[0], d[1], d[2])) == wanted
    assert [(w.file, w.is_own_gait, w.seeds) for w in found] == [
        (n, k == 0, seeds[n]) for n in "ab" for k in range(3)
    ]
    assert [w.predicted.mean for w in found[:3]] == pytest.approx([0.0, 0.1, 0.2])
    assert found[0].mujoco.displacement.tolist() == [11.0, FALL, 13.0]
    assert found[0].faults == ("", "folds", "") and found[0].fault_counts == {"folds": 1}


def test_wrong_input_is_one_line_and_writes_nothing(tmp_path: Path) -> None:
    good, out = tmp_path / "good.json", tmp_path / "out"
    DESIGN.save(good)
    assert "none.json does not exist" in refused(tmp_path / "none.json", "--out", out)
    (tmp_path / "foreign.json").write_text('{"format": "eldir-report/1"}')
    assert "invalid format of" in refused(good, tmp_path / "foreign.json", "--out", out)
    assert "given twice" in refused(good, good, "--out", out)
    assert "none.yaml" in refused(good, "--rig", tmp_path / "none.yaml", "--out", out)
    tiny_design({"gait": {"period_s": 20.0, "phase": [0.0]}}).save(tmp_path / "damaged.json")
    damaged = refused(good, tmp_path / "damaged.json", "--out", out)
    assert "damaged.json: the design's gait: duty is missing" in damaged
    one = {"period_s": 20.0, "phase": [0.0], "duty": [0.3], "method": "search"}
    tiny_design({"gait": one}).save(tmp_path / "one.json")
    told = refused(tmp_path / "one.json", "--out", out)
    assert "invalid number of phases in the design's gait; expected 2, one for each motor; found 1" in told
    slow = {"period_s": 1e6, "phase": [0.0, 0.0], "duty": [0.3, 0.3], "method": "search"}
    tiny_design({"gait": slow}).save(tmp_path / "slow.json")
    assert "too slow" in refused(tmp_path / "slow.json", "--out", out)
    assert transfer(good, "--samples", 1, "--out", out).exit_code == 2
    assert not out.exists() and not list(tmp_path.glob(".out*"))


def test_a_design_that_cannot_walk_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    design = tiny_design({})
    monkeypatch.setattr(type(design.morphology), "motors", property(lambda self: 0))
    design.save(tmp_path / "still.json")
    monkeypatch.setattr("eldir_calibration.transfer.compared_walks.Design.load", lambda path: design)
    with raises(InputError, "design.no-walk", match="still.json .*found no motor"):
        load_walking_design(str(tmp_path / "still.json"), SpringParameters())


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    DESIGN.save(tmp_path / "tiny.json")
    (tmp_path / "out").mkdir()
    assert "exists already" in refused(tmp_path / "tiny.json", "--out", tmp_path / "out")
    assert list((tmp_path / "out").iterdir()) == []


def test_without_mujoco_one_line_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    DESIGN.save(tmp_path / "tiny.json")
    found = transfer(tmp_path / "tiny.json", "--out", tmp_path / "out")
    assert isinstance(found.exception, MissingDependencyError)
    assert "pip install 'eldir[mujoco]'" in str(found.exception) and not (tmp_path / "out").exists()


def test_an_interrupted_run_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C in the second robot in MuJoCo."""
    done: list[int] = []
    follow = mujoco_walks.MujocoMotion.follow

    def interrupted(self: object, lengths: np.ndarray, interval: float) -> None:
        done.append(1)
        if len(done) == 8:
            raise KeyboardInterrupt
        follow(self, lengths, interval)  # type: ignore[arg-type]

    monkeypatch.setattr(mujoco_walks.MujocoMotion, "follow", interrupted)
    DESIGN.save(tmp_path / "tiny.json")
    found = transfer(tmp_path / "tiny.json", *SMALL, "--out", tmp_path / "out")
    assert found.exit_code != 0 and 8 <= len(done) < 20, "robots that walk beside it go on for a moment"
    assert [p.name for p in tmp_path.iterdir()] == ["tiny.json"]
