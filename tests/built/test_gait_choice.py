"""The second round: gaits searched for the filmed robot, and what the camera saw walking is kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import eldir.built.ensembles
from calibration.dynamics.individual import individual, own_names
from calibration.dynamics.results import _parts
from calibration.dynamics.upright import stayed_upright
from eldir.built import gait_choice as keeping
from eldir.built.ensembles import Ensemble, as_found, ensemble, ensembles
from eldir.built.filmed_gait import SeenGait
from eldir.built.gait import CYCLES, Gait, free_lengths
from eldir.built.gait_choice import choose
from eldir.built.motion import drive
from eldir.built.robot import build
from eldir.built.scene import BuiltScene
from eldir.built.screening import candidate_gaits, displacements
from eldir.design import Design
from eldir.errors import EldirError
from eldir.lattice import Lattice
from eldir.parameters.uncertain import Specimen, specimen
from eldir.trajectory import Trajectory
from hardware.analysis import predictions as predicting
from hardware.analysis.recorded_run import RecordedRun
from hardware.commands.gait import gait as command
from hardware.planning import plan as planning
from hardware.planning.compiler import compile_schedule, gait_of
from hardware.planning.plan import plan, robust_gait
from hardware.rig.template import virtual_rig
from hardware.schedule import Event
from tests.calibration.rigs import SOFT, walker
from tests.eldir.test_design import make_design
from tests.hardware.test_schedule import rig_with

RIG = rig_with()
WALKED = Gait(20.0, np.array([0.0, 0.25]), np.array([0.3, 0.3]))


@pytest.fixture(scope="module")
def design() -> Design:
    return make_design(10, Lattice(3, 6))


def scene_of(
    design: Design, *seen: SeenGait, whole: Specimen = SOFT, doubt: float = 0.1, **results: object
) -> BuiltScene:
    """As `eldir calibrate dynamics` would write it, friction and hot length in doubt."""
    driven = [s.to_json() for s in seen]
    return BuiltScene(
        *whole, ("friction", "hot_length"), doubt**2 * np.eye(2), {"driven": driven} | results,
        {"body": design.body},
    )  # fmt: skip


def seen(walked: float, gait: Gait = WALKED, upright: bool = True) -> SeenGait:
    return SeenGait(gait, walked, upright, 5, "log.mcap")


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
    monkeypatch.setattr(keeping, "as_found", lambda *_: np.array([itself, again]))
    other, scene = replace(WALKED, period=25.0), scene_of(design, model={"fits": fits})
    found = choose(design, other, Ensemble(np.array(walks)), [seen(saw)], scene)
    assert (found.kept is not None) == kept
    assert (found.gait == WALKED) if kept else (found.gait is other)
    assert found.told.startswith(f"kept: seen walking {saw:+.2f}; " if kept else "re-planned: promises +0.90")


def test_gaits_that_fell_or_went_back_are_not_kept(design: Design) -> None:
    for film in (seen(1.0, upright=False), seen(-0.5), seen(0.05)):
        found = choose(design, WALKED, Ensemble(np.array([0.1])), [film], scene_of(design))
        assert (found.kept, found.told) == (None, "re-planned: no filmed gait walked")


def test_a_plan_keeps_the_filmed_gait_and_says_so(
    design: Design, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Farther than any robot goes: kept, through the files and the command. Seen falling: never again."""
    monkeypatch.setattr(eldir.built.ensembles, "CYCLES", 1)
    monkeypatch.setattr(planning, "_BUILDS", 1)
    monkeypatch.setattr(planning, "candidate_gaits", lambda motors: [WALKED])
    monkeypatch.setattr(
        planning, "_retimed", lambda *_: [replace(WALKED, period=25.0, duty=0.8 * WALKED.duty)]
    )
    monkeypatch.setattr(planning, "imitated_gait", lambda _: WALKED)
    monkeypatch.setattr(planning, "foresee", lambda *_: {})
    monkeypatch.setattr(eldir.built.ensembles, "_HALVINGS", 1)
    scene_of(design, seen(5.0)).save(tmp_path / "scene.json")
    scene = BuiltScene.load(tmp_path / "scene.json")
    kept = plan(design, RIG, scene=scene, builds=2)
    played = gait_of(kept)
    assert played is not None and seen(5.0).is_of(played)
    assert kept.predicted["method"] == "seen" and kept.predicted["displacement"]["seen"]["seen"] == 5.0
    assert kept.predicted["choice"].startswith("kept: seen walking +5.00; the best other promises ")
    fell = plan(design, RIG, scene=scene_of(design, seen(5.0, upright=False)), builds=2)
    assert fell.predicted["method"] == "search"
    assert fell.predicted["choice"] == "re-planned: no filmed gait walked"
    played = gait_of(fell)
    assert played is not None and not seen(5.0).is_of(played)


def test_a_scene_knows_its_robot(design: Design, tmp_path: Path) -> None:
    """Another body, and the same with a weight on it, did not walk this way."""
    scene_of(design, seen(0.7)).save(tmp_path / "scene.json")
    scene = BuiltScene.load(tmp_path / "scene.json")
    taught = replace(design, controller=replace(design.controller, b2=design.controller.b2 + 1.0))
    assert scene.seen_of(design) == scene.seen_of(taught) == [seen(0.7)]
    loaded = replace(design, provenance={"variant": {"ballast": {"grams": 9.0, "mass": 0}}})
    assert not scene.seen_of(make_design(44, Lattice(3, 6))) and not scene.seen_of(loaded)
    heavy = replace(scene, provenance=scene.provenance | {"ballast_kg": loaded.ballast.tolist()})
    assert heavy.seen_of(loaded) and not heavy.seen_of(design)


def test_found_parts_are_those_of_the_fit() -> None:
    """Against the robot that the fit itself would drive."""
    body = walker().morphology
    names = own_names(body)
    turns = np.random.default_rng(2).standard_normal(len(names))
    whole = individual(body, SOFT, ("friction", *names), [1.0, *turns])
    scene = BuiltScene(*whole.specimen, (), np.zeros((0, 0)), {"parts": _parts(whole)}, {"body": "it"})
    parts = scene.parts_of(_only_body("it"))
    assert parts is not None and scene.parts_of(_only_body("another")) is None
    robot = parts.robot(body, scene.specimen, 0.01)
    assert robot == whole.robot(body, 0.01) or np.allclose(
        robot.rest_lengths, whole.robot(body, 0.01).rest_lengths, atol=1e-8
    )
    for mine, true in zip(parts.springs(scene.specimen, 2), whole.springs, strict=True):
        for name, value in vars(true).items():
            assert getattr(mine, name) == pytest.approx(value, rel=1e-5), name


def _only_body(body: str) -> Design:
    """Stands for a design of this body."""
    return type("Stand", (), {"body": body})()


def test_parts_reach_ensemble_gait_and_report(design: Design) -> None:
    """Springs far apart: every prediction is that of the robot put together by hand, not of its mean."""
    body, springs = design.morphology, SOFT[1]
    longer = np.array([1.05, 1 / 1.05])
    values = {"hot_length": (springs.hot_length * longer).tolist()}
    strips = np.where(body.active, 0.0, 0.4e-3 * (-1.0) ** np.arange(len(body.springs)))
    scene = scene_of(design, parts={"strips_m": strips.tolist(), "springs": values})
    parts = scene.parts_of(design)
    built = build(body, SOFT[0])
    robot = replace(built, rest_lengths=built.rest_lengths + strips)
    own = [replace(springs, hot_length=springs.hot_length * x) for x in longer]
    free = (springs.cold_length, springs.hot_length)
    (walk,) = displacements([robot], [free_lengths(WALKED, own)], CYCLES, free)
    found = as_found(body, [WALKED, WALKED], scene, parts)
    assert found == pytest.approx([walk, walk], abs=1e-9)
    (mean,) = as_found(body, [WALKED], scene, None)
    assert np.isfinite(walk) and abs(mean - walk) > 0.02
    certain = replace(scene, covariance=np.zeros((2, 2)))
    drawn = ensemble(body, WALKED, 2, scene=certain, parts=parts).displacement
    assert drawn == pytest.approx([walk, walk], abs=1e-9)
    schedule = compile_schedule(WALKED, RIG, tuple(np.flatnonzero(body.active).tolist()), cycles=2)
    driven = RecordedRun(design, schedule, RIG)
    turns = [predicting._own(driven, one) for one in (scene, replace(scene, results={}))]
    assert turns[0].robot.rest_lengths == pytest.approx(robot.rest_lengths, abs=1e-12)
    true, plain = (m.trajectory.positions for m in predicting._drive(turns) if m)
    (moved,) = drive([robot], [turns[0].lengths], 0.05, free=free)
    assert np.abs(true - moved.positions[:, design.marks]).max() < 1e-9
    assert turns[0].lengths.max(axis=0) == pytest.approx(springs.hot_length * longer, rel=1e-3)
    assert np.abs(true - plain).max() > 1e-3


def test_what_falls_in_the_filmed_robots_is_not_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    """A body whose hot springs are longer than drawn: what carries the nominal one farthest topples it."""
    monkeypatch.setattr(eldir.built.ensembles, "CYCLES", 1)
    monkeypatch.setattr(planning, "_BUILDS", 3)
    design, phases = make_design(10, Lattice(3, 6)), candidate_gaits(2)[::2]
    monkeypatch.setattr(planning, "candidate_gaits", lambda motors: phases)
    scene = scene_of(design, whole=specimen(SOFT, ["hot_length"], [2.0]), doubt=0.3)
    tried: list[tuple[Gait, Ensemble]] = []

    def watched(*arguments: Any, **more: Any) -> list[Ensemble]:
        found = ensembles(*arguments, **more)
        tried.extend(zip(arguments[1], found, strict=True))
        return found

    monkeypatch.setattr(planning, "ensembles", watched)
    found = robust_gait(design, RIG, scene)
    nominal = as_found(design.morphology, phases, scene_of(design), None)
    fastest = phases[int(nominal.argmax())]
    assert nominal.max() > 0.05
    assert next(walks for gait, walks in tried if gait is fastest).fallen > 0.5
    assert found is not fastest
    chosen = next(walks for gait, walks in tried if gait is found)
    assert chosen.fallen == 0 and chosen.expected > 0
    assert len({g.period for g, _ in tried}) == 3 and len({round(g.duty[0], 3) for g, _ in tried}) > 2


def test_neither_the_robot_itself_nor_those_around_it_may_fall(
    design: Design, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Judged by stand-ins: of four phases one walks far in the robot itself and one in those around it."""
    phases = candidate_gaits(2)[:4]
    drawn, itself = [0.1, 2.0, 0.4, 0.5], [2.0, -np.inf, 0.5, 0.3]
    monkeypatch.setattr(planning, "candidate_gaits", lambda motors: phases)
    monkeypatch.setattr(planning, "_retimed", lambda *_: [])
    monkeypatch.setattr(planning, "ensembles", lambda *_, **__: [Ensemble(np.array([x])) for x in drawn])
    monkeypatch.setattr(planning, "as_found", lambda *_: np.array(itself))
    assert robust_gait(design, RIG, scene_of(design)) is phases[2]
    assert robust_gait(design, RIG, scene_of(design), [seen(0.4, phases[2])]) is phases[3]


def test_robots_drawn_do_what_was_filmed(design: Design, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that would not are moved towards the identified one, and no farther than they must be."""
    monkeypatch.setattr(eldir.built.ensembles, "CYCLES", 1)
    scene, body = scene_of(design, doubt=1.0), design.morphology
    (itself,) = as_found(body, [WALKED], scene, None)
    free, bound = (ensemble(body, WALKED, 6, 3, scene=scene, filmed=f).displacement for f in ([], [WALKED]))
    assert np.isfinite(itself) and (np.abs(bound - itself) <= 0.1).all()
    right = np.abs(free - itself) <= 0.1
    assert 0 < right.sum() < 6 and (bound[right] == free[right]).all()
    assert (np.abs(bound - itself)[~right] > 1e-3).all(), "they stay other robots"


def test_a_schedule_gives_its_gait_back() -> None:
    for phase, duty in (((0.0, 0.875), (0.3, 0.25)), ((0.4, 0.0), (0.2, 0.0))):
        gait = Gait(19.7, np.array(phase), np.array(duty))
        found = gait_of(compile_schedule(gait, RIG, springs=(7, 12)))
        assert found is not None and seen(1.0, found).is_of(gait)
        assert not seen(1.0, found).is_of(replace(gait, period=19.9))
    once = compile_schedule(WALKED, RIG)
    twice = [Event(e.t_s + 1.0, *e[1:]) for e in once.events if e.spring == 0]
    twice = [e._replace(t_s=e.t_s + 8) for e in twice]
    assert gait_of(replace(once, events=tuple(sorted([*once.events, *twice])))) is None


def test_a_robot_that_lies_is_told_by_its_marks() -> None:
    rng = np.random.default_rng(1)
    rest, t = rng.uniform(0, 0.2, (5, 2)), np.arange(0, 30, 0.1)

    def upright(turn: np.ndarray) -> bool:
        c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
        x, y = rest.T
        there = np.stack([c * x - s * y + t[:, None], s * x + c * y], axis=2)
        there += 0.2e-3 * rng.standard_normal(there.shape)
        there[rng.random(there.shape[:2]) < 0.2] = np.nan
        return stayed_upright(rest, Trajectory(tuple("abcde"), t, there))

    assert upright(0.5 * np.sin(t))
    assert upright(np.where((t > 9) & (t < 9.5), 2.0, 0.0)), "five mistaken frames"
    for angle in (1.0, -1.6, 2.8):
        assert not upright(np.where(t > 20, angle, 0.0))


def test_what_cannot_be_written_is_said_before_the_search(design: Design, tmp_path: Path) -> None:
    design.save(tmp_path / "design.json")
    (tmp_path / "rig.yaml").write_text(virtual_rig())
    app = typer.Typer()
    app.command()(command)
    for out, why in ((tmp_path, "exists already"), (tmp_path / "rig.yaml" / "s.json", "is no folder")):
        call = [str(tmp_path / "design.json"), "--rig", str(tmp_path / "rig.yaml"), "--out", str(out)]
        ran = CliRunner().invoke(app, call)
        assert isinstance(ran.exception, EldirError) and why in str(ran.exception)
