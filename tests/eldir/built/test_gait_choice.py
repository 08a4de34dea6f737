"""The second round: gaits searched for the filmed robot, and what the camera saw walking is kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from eldir.built import gait_choice, gait_search, samples
from eldir.built.gait import CYCLES, FilmedGait, Gait, free_lengths
from eldir.built.gait_choice import choose_gait
from eldir.built.motion import drive
from eldir.built.robot import build
from eldir.built.samples import IdentifiedRobots, SampledWalks, sample_walks, simulate_most_probable
from eldir.built.scene import PrintedScene
from eldir.built.walking import displacements
from eldir.design import Ballast, Design, Variant
from eldir.errors import EldirError
from eldir.lattice import Lattice
from eldir.parameters.robot import part_names, perturb_robot
from eldir.trajectory import Trajectory
from eldir_app.commands.gait import gait as command
from eldir_calibration.comparison import predictions as predicting
from eldir_calibration.comparison.recorded_run import RecordedRun
from eldir_calibration.dynamics.recording import find_fall
from eldir_calibration.dynamics.results import part_numbers
from eldir_hardware.planning import plan as planning
from eldir_hardware.planning.compiler import compile_schedule, extract_gait
from eldir_hardware.planning.plan import PlanConfig, plan
from eldir_hardware.rig.template import virtual_rig
from tests.calibration.dynamics.hidden_rigs import SOFT, walker
from tests.eldir.built.filmed_scenes import WALKED, film, scene_of
from tests.eldir.random_design import make_design
from tests.hardware.rigs_and_schedules import rig_with

RIG = rig_with()


@pytest.fixture(scope="module")
def design() -> Design:
    return make_design(10, Lattice(3, 6))


@pytest.mark.parametrize(
    ("fits", "walks", "itself", "again", "saw", "kept"),
    [
        (True, [0.8, 1.0], 0.9, 0.5, 0.5, False),
        (True, [0.8, 1.0], 0.9, 0.5, 0.8, True),  # not by more than two such robots differ
        (False, [0.8, 1.0], 0.9, 0.5, 0.5, False),
        (False, [0.7, 1.1], 0.9, 0.5, 0.5, True),  # of a model that does not fit twice that is asked
        (True, [0.8, 1.0], -np.inf, 0.5, 0.5, True),  # the robot itself would fall
        (True, [0.8, 1.0], 0.9, 1.0, 0.5, True),  # half a body length wrong about what was seen
        (True, [1.8, -np.inf], 1.8, 0.5, 0.5, True),  # half of those robots fall
    ],
)
def test_what_was_seen_walking_is_kept_unless_another_is_better_beyond_doubt(
    design: Design,
    monkeypatch: pytest.MonkeyPatch,
    fits: bool,
    walks: list[float],
    itself: float,
    again: float,
    saw: float,
    kept: bool,
) -> None:
    monkeypatch.setattr(gait_choice, "simulate_most_probable", lambda *_: np.array([itself, again]))
    other, scene = replace(WALKED, period=25.0), scene_of(design, model_fits=fits)
    found = choose_gait(design, other, SampledWalks(np.array(walks)), [film(saw)], scene)
    assert (found.kept_film is not None) == kept
    assert (found.gait == WALKED) if kept else (found.gait is other)
    expected = (
        f"filmed gait kept: it walked {saw:+.2f}; " if kept else "new gait: predicted +0.90 (required margin "
    )
    assert found.reason.startswith(expected)


def test_gaits_that_fell_or_went_back_are_not_kept(design: Design) -> None:
    for one in (film(1.0, upright=False), film(-0.5), film(0.05)):
        found = choose_gait(design, WALKED, SampledWalks(np.array([0.1])), [one], scene_of(design))
        assert (found.kept_film, found.reason) == (None, "new gait: no filmed gait walked")
    # Decision 26: forward by a tenth of a body length or more is a walk.
    assert film(0.12).has_walked and not film(0.08).has_walked


def test_a_robot_that_was_lost_is_preferred_to_none_that_walked_to_the_end(
    design: Design, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may have fallen. If it is kept for want of another film, that is said."""
    monkeypatch.setattr(gait_choice, "simulate_most_probable", lambda _, gaits: np.zeros(len(gaits)))
    slow, lost = film(0.4, replace(WALKED, period=25.0)), film(1.9, lost=95.0)
    for films, kept in (([lost, slow], slow), ([lost, film(3.0, upright=False)], lost)):
        found = choose_gait(design, WALKED, SampledWalks(np.array([0.1])), films, scene_of(design, *films))
        assert found.kept_film is kept
        remark = " (lost at 95 s: fell, left the picture or was covered)" if kept is lost else ""
        assert found.reason.startswith(f"filmed gait kept: it walked {kept.walked:+.2f}{remark}; predicted")
    assert lost.has_walked and not lost.has_fallen and FilmedGait.from_json(lost.to_json()) == lost
    assert "lost_at_s" not in slow.to_json()


def test_a_plan_keeps_the_filmed_gait_and_says_so(
    design: Design, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Farther than any robot goes: kept, through the files and the command. Seen falling: never again."""
    monkeypatch.setattr(samples, "CYCLES", 1)
    monkeypatch.setattr(gait_search, "_SAMPLES", 1)
    monkeypatch.setattr(gait_search, "candidate_gaits", lambda motors: [WALKED])
    monkeypatch.setattr(
        gait_search, "_retime", lambda *_: [replace(WALKED, period=25.0, duty=0.8 * WALKED.duty)]
    )
    monkeypatch.setattr(planning, "predict_cycle", lambda *_: None)
    monkeypatch.setattr(planning, "heat_margins", lambda *_: None)
    monkeypatch.setattr(samples, "_HALVINGS", 1)
    scene_of(design, film(5.0)).save(tmp_path / "scene.json")
    scene = PrintedScene.load(tmp_path / "scene.json")
    kept = plan(design, RIG, PlanConfig(scene=scene, samples=2))
    played = extract_gait(kept)
    assert played is not None and film(5.0).shows(played)
    assert kept.predicted.method == "filmed" and kept.predicted.walk.filmed == 5.0
    said = "filmed gait kept: it walked +5.00; predicted for the best other: "
    assert kept.predicted.choice.startswith(said)
    fell = plan(design, RIG, PlanConfig(scene=scene_of(design, film(5.0, upright=False)), samples=2))
    assert fell.predicted.method == "search"
    assert fell.predicted.choice == "new gait: no filmed gait walked"
    played = extract_gait(fell)
    assert played is not None and not film(5.0).shows(played)


def test_a_scene_knows_its_robot(design: Design, tmp_path: Path) -> None:
    """Another body, and the same with a weight on it, did not walk this way."""
    scene_of(design, film(0.7)).save(tmp_path / "scene.json")
    scene = PrintedScene.load(tmp_path / "scene.json")
    trained = replace(design, controller=replace(design.controller, b2=design.controller.b2 + 1.0))
    assert scene.filmed_of(design) == scene.filmed_of(trained) == [film(0.7)]
    loaded = replace(design, variant=Variant(ballast=Ballast(9.0, 0)))
    assert not scene.filmed_of(make_design(44, Lattice(3, 6))) and not scene.filmed_of(loaded)
    heavy = replace(scene, ballast_kg=loaded.ballast)
    assert heavy.filmed_of(loaded) and not heavy.filmed_of(design)


def test_found_parts_are_those_of_the_fit(tmp_path: Path) -> None:
    """Against the robot that the fit itself would drive, through the file."""
    body = walker().morphology
    names = part_names(body)
    z = np.random.default_rng(2).standard_normal(len(names))
    fitted = perturb_robot(body, SOFT, ("friction", *names), [1.0, *z])
    scene = PrintedScene.of(fitted.uniform.with_parts(*part_numbers(fitted)), (), np.zeros((0, 0)))
    scene = replace(scene, body="it")
    scene.save(tmp_path / "scene.json")
    assert PrintedScene.load(tmp_path / "scene.json") == scene
    found = scene.robot_of(_only_body("it"))
    assert scene.robot_of(_only_body("another")) == fitted.uniform
    assert np.allclose(
        build(body, found, ballast=0.01).rest_lengths,
        build(body, fitted, ballast=0.01).rest_lengths,
        atol=1e-8,
    )
    for mine, true in zip(found.motor_springs(2), fitted.motor_springs(2), strict=True):
        for name, value in vars(true).items():
            assert getattr(mine, name) == pytest.approx(value, rel=1e-5), name


def _only_body(body: str) -> Design:
    """Stands for a design of this body."""
    return type("Stand", (), {"body": body})()


def test_parts_reach_samples_gait_and_report(design: Design) -> None:
    """Springs far apart: every prediction is that of the robot put together by hand, not of its mean."""
    body, springs = design.morphology, SOFT.springs
    longer = np.array([1.05, 1 / 1.05])
    strips = np.where(body.active, 0.0, 0.4e-3 * (-1.0) ** np.arange(len(body.springs)))
    scene = scene_of(design, robot=SOFT.with_parts(strips, {"hot_length": springs.hot_length * longer}))
    built = build(body, SOFT.printed)
    robot = replace(built, rest_lengths=built.rest_lengths + strips)
    own = [replace(springs, hot_length=springs.hot_length * x) for x in longer]
    free = (springs.cold_length, springs.hot_length)
    (walk,) = displacements([robot], [free_lengths(WALKED, own)], CYCLES, free)
    robots = IdentifiedRobots.of(design, scene)
    found = simulate_most_probable(robots, [WALKED, WALKED])
    assert found == pytest.approx([walk, walk], abs=1e-9)
    (mean,) = simulate_most_probable(replace(robots, robot=SOFT), [WALKED])
    assert np.isfinite(walk) and abs(mean - walk) > 0.02
    (drawn,) = sample_walks(replace(robots, covariance=np.zeros((2, 2))), [WALKED], 2)
    samples = replace(robots, covariance=np.zeros((2, 2))).samples(2, 0)
    by_hand = [replace(robot, feet=sample.feet) for sample in samples]
    tables = [free_lengths(WALKED, own)] * 2
    assert drawn.displacement == pytest.approx(displacements(by_hand, tables, CYCLES, [free] * 2), abs=1e-9)
    schedule = compile_schedule(WALKED, RIG, tuple(np.flatnonzero(body.active).tolist()), cycles=2)
    run = RecordedRun(design, schedule, RIG)
    simulations = [predicting._prepare_run(run, one) for one in (scene, scene_of(design))]
    assert simulations[0].robot.rest_lengths == pytest.approx(robot.rest_lengths, abs=1e-12)
    true, plain = (m.motion.trajectory.positions for m in predicting._simulate(simulations)[0] if m.motion)
    (moved,) = drive([robot], [simulations[0].lengths], 0.05, free=free)
    assert np.abs(true - moved.positions[:, design.marks]).max() < 1e-9
    assert simulations[0].lengths.max(axis=0) == pytest.approx(springs.hot_length * longer, rel=1e-3)
    assert np.abs(true - plain).max() > 1e-3


def test_robots_drawn_do_what_was_filmed(design: Design, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that would not are moved towards the identified one, and no farther than they must be."""
    monkeypatch.setattr(samples, "CYCLES", 1)
    scene = scene_of(design, spread=1.0)
    robots = [IdentifiedRobots.of(design, scene, filmed) for filmed in ([], [WALKED])]
    (itself,) = simulate_most_probable(robots[0], [WALKED])
    free, bound = (sample_walks(one, [WALKED], 6, 3)[0].displacement for one in robots)
    assert np.isfinite(itself) and (np.abs(bound - itself) <= 0.1).all()
    right = np.abs(free - itself) <= 0.1
    assert 0 < right.sum() < 6 and (bound[right] == free[right]).all()
    assert (np.abs(bound - itself)[~right] > 1e-3).all(), "they stay other robots"


def test_a_schedule_gives_its_gait_back() -> None:
    for phase, duty in (((0.0, 0.875), (0.3, 0.25)), ((0.4, 0.0), (0.2, 0.0))):
        gait = Gait(19.7, np.array(phase), np.array(duty))
        found = extract_gait(compile_schedule(gait, RIG, springs=(7, 12)))
        assert found is not None and film(1.0, found).shows(gait)
        assert not film(1.0, found).shows(replace(gait, period=19.9))
    once = compile_schedule(WALKED, RIG)
    twice = [replace(e, t_s=e.t_s + 1.0) for e in once.events if e.spring == 0]
    twice = [replace(e, t_s=e.t_s + 8) for e in twice]
    assert extract_gait(replace(once, events=tuple(sorted([*once.events, *twice])))) is None


def test_a_robot_that_lies_is_told_by_its_marks() -> None:
    rng = np.random.default_rng(1)
    rest, t = rng.uniform(0, 0.2, (5, 2)), np.arange(0, 30, 0.1)

    def upright(turn: np.ndarray) -> bool:
        c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
        x, y = rest.T
        there = np.stack([c * x - s * y + t[:, None], s * x + c * y], axis=2)
        there += 0.2e-3 * rng.standard_normal(there.shape)
        there[rng.random(there.shape[:2]) < 0.2] = np.nan
        return find_fall(rest, Trajectory(tuple("abcde"), t, there)) is None

    assert upright(0.5 * np.sin(t))
    assert upright(np.where((t > 9) & (t < 9.5), 2.0, 0.0)), "five mistaken frames"
    for angle in (1.0, -1.6, 2.8):
        assert not upright(np.where(t > 20, angle, 0.0))


def test_what_cannot_be_written_is_said_before_the_search(design: Design, tmp_path: Path) -> None:
    design.save(tmp_path / "design.json")
    (tmp_path / "rig.yaml").write_text(virtual_rig())
    app = typer.Typer()
    app.command()(command)
    for out, why in ((tmp_path, "exists already"), (tmp_path / "rig.yaml" / "s.json", "is not a folder")):
        call = [str(tmp_path / "design.json"), "--rig", str(tmp_path / "rig.yaml"), "--out", str(out)]
        ran = CliRunner().invoke(app, call)
        assert isinstance(ran.exception, EldirError) and why in str(ran.exception)
