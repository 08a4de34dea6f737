"""The shortlist: the build filter first, then what the built scene predicts, told with reasons."""

import json
from dataclasses import replace
from functools import partial

import jsonschema
import numpy as np
import pytest

from eldir.built import screening
from eldir.built.gait import Gait, read_gait
from eldir.built.robot import build, find_shape_fault
from eldir.built.samples import SampledWalks, sample_walks
from eldir.built.screening import ScreeningResult
from eldir.built.walking import displacements
from eldir.design import Design
from eldir.errors import EldirError, InputError
from eldir.evolution import designs as designs_of_runs
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.run_folder import RunFolder
from eldir.evolution.printed.configuration import PrintedEvolutionConfig
from eldir.evolution.printed.run_folder import PrintedRun
from eldir.lattice import Lattice
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.tolerances import RigTolerances
from eldir_app.commands.shortlist import shortlist as command
from eldir_cad.checks.lateral_stability import predict_lateral_stability
from eldir_cad.checks.strip_law import spring_parameters
from eldir_cad.checks.tipping import with_gap
from eldir_cad.checks.violations import BuildReport
from eldir_cad.kit.printer import fit_to_printer, load_printer
from eldir_cad.kit.specification import kit_file, load_specification
from eldir_cad.shortlist import ranking as module
from eldir_cad.shortlist.folder import write_shortlist
from eldir_cad.shortlist.ranking import RankedDesign, Shortlist, rank
from tests.cad.drawn_bodies import BLOCK, HOURGLASS, TOWER, WHEEL, design
from tests.eldir.built.grounds import plane
from tests.eldir.evolution.run_folders import go_on
from tests.paths import SCHEMAS
from tests.raised import raises

SCHEMA = SCHEMAS / "ranking.schema.json"
SAMPLES, CYCLES = 2, 2
# Two legs 100 mm apart, a mechanism that its two motors close.
WALKER = design("1111100", "1100111", "0100010", "0000000", motors=(17, 23))


@pytest.fixture(scope="module")
def ranked(tmp_path_factory):
    patch = pytest.MonkeyPatch()
    # Sixteen samples and five cycles take twenty times as long.
    patch.setattr(module, "sample_walks", partial(sample_walks, n=SAMPLES, cycles=1))
    patch.setattr(screening, "CYCLES", CYCLES)
    stages = []
    found = rank(
        [WALKER, design(*TOWER), WALKER, design(*BLOCK, motors=(40, 41, 42))],
        top=2,
        progress=lambda stage, share: stages.append((stage, share)),
    )
    patch.undo()
    out = tmp_path_factory.mktemp("shortlists") / "shortlist"
    rows = write_shortlist(found, out)
    return found, rows, out, stages


def test_only_what_can_be_built_and_stands_is_ranked(ranked):
    found, rows, _, _ = ranked
    assert found.considered == 3  # the walker came twice
    assert [c.design for c in found.candidates] == [WALKER]
    assert found.left_out == {"mechanism": 1, "motors": 1}
    assert len(rows) == 1


def test_files_say_what_is_predicted(ranked):
    _found, rows, out, _ = ranked
    ranking = json.loads((out / "ranking.json").read_text())
    rules = json.loads(SCHEMA.read_text())
    jsonschema.Draft202012Validator.check_schema(rules)
    jsonschema.validate(ranking, rules)
    assert ranking["designs"] == [row.to_json() for row in rows]
    chosen = Design.load(out / rows[0].file)
    assert chosen.genotype == WALKER.genotype and chosen.controller == WALKER.controller
    assert chosen.provenance == WALKER.provenance | {k: rows[0].to_json()[k] for k in ("gait", "predicted")}
    assert sorted(p.name for p in out.iterdir()) == ["design_01.json", "ranking.json", "shortlist.png"]


def test_the_predicted_displacement_is_that_of_the_gait(ranked):
    from eldir.built.gait import free_lengths

    found, rows, _, _ = ranked
    springs = SpringParameters(current_limit=3.6)  # of the parts, and of a new rig file
    gait = found.candidates[0].gait
    again = displacements(
        [build(WALKER.morphology)],
        [free_lengths(gait, springs, CYCLES)],
        CYCLES,
        (springs.cold_length, springs.hot_length),
    )
    assert rows[0].predicted.body_lengths_per_5_cycles == pytest.approx(float(again[0]), abs=1e-9)
    walks = found.candidates[0].spread.displacement
    predicted = rows[0].to_json()["predicted"]["sampled_walks"]
    assert predicted["mean"] == pytest.approx(np.mean(walks[np.isfinite(walks)]))
    with_falls = np.where(np.isfinite(walks), walks, 0.0)
    assert predicted["expected"] == pytest.approx(with_falls.mean())
    assert predicted["standard_error"] == pytest.approx(with_falls.std(ddof=1) / np.sqrt(SAMPLES))
    assert predicted["samples"] == SAMPLES
    length = 57 * np.ptp(WALKER.morphology.positions[:, 0]) / 0.05  # the printed pitch, not the lattice's
    five = with_falls.mean() * length
    assert 5 * predicted["mm_per_cycle"] == pytest.approx(five)
    assert 5 * gait.period / 60 * predicted["mm_per_minute"] == pytest.approx(five)


def test_a_nominal_robot_that_falls_has_no_walk(tmp_path):
    """Evolved with its gait, in which samples of it stay upright."""
    gait = Gait(20.0, np.zeros(2), np.full(2, 0.25), "evolved")
    fallen = ScreeningResult(0, 0.03, 0, np.array([-np.inf]), gait, True, "")
    walks = SampledWalks(np.array([0.5, 0.7]))
    one = RankedDesign(WALKER, BuildReport.of((), {}), fallen, gait, walks)
    write_shortlist(Shortlist((one,), 1, {}), tmp_path / "shortlist")
    (row,) = json.loads((tmp_path / "shortlist" / "ranking.json").read_text())["designs"]
    found = row["predicted"]
    assert found["body_lengths_per_5_cycles"] is None and found["sampled_walks"]["tie_share"] is None
    assert found["sampled_walks"]["expected"] == pytest.approx(0.6)
    assert Design.load(tmp_path / "shortlist" / "design_01.json").provenance["predicted"] == found


def test_the_list_says_which_designs_share_a_body(tmp_path):
    """The mirror image is the same body; other motors in the same springs are told apart."""
    gait = Gait(20.0, np.zeros(2), np.full(2, 0.25), "evolved")
    mirrored = design("0011111", "1110011", "0100010", "0000000", motors=(1, 5))
    other = design("1111100", "1100111", "0100010", "0000000", motors=(17, 22))
    screened = ScreeningResult(0, 0.03, 0, np.array([0.5]), gait, True, "")
    walks = SampledWalks(np.array([0.5, 0.7]), np.zeros(2))
    ranked = [
        RankedDesign(d, BuildReport.of((), {}), screened, gait, walks) for d in (WALKER, mirrored, other)
    ]
    write_shortlist(Shortlist(tuple(ranked), 3, {}), tmp_path / "list")
    ranking = json.loads((tmp_path / "list" / "ranking.json").read_text())
    jsonschema.validate(ranking, json.loads(SCHEMA.read_text()))
    first, same, cousin = ranking["designs"]
    assert first["body"] == same["body"] != cousin["body"]
    told = [(d.get("same_body_as"), d.get("spring_overlap")) for d in (first, same, cousin)]
    assert told == [(None, None), ("design_01.json", 1.0), (None, 1.0)]


@pytest.mark.parametrize("top", [1, 3, 9])
def test_the_counts_add_up(top, monkeypatch):
    """Bodies on the list and all that were left out, with a place for few or for all of ten that stand."""
    walker = WALKER.morphology
    gait = Gait(20.0, np.zeros(walker.motors), np.full(walker.motors, 0.25))
    stands = [ScreeningResult(i, 0.03, 0, np.array([0.5 - 0.01 * i]), gait, True, "") for i in range(10)]
    monkeypatch.setattr(module, "_unique_bodies", lambda designs: [WALKER] * 10)
    monkeypatch.setattr(module, "_filter_buildable", lambda designs, *_: [(d, None) for d in designs])
    monkeypatch.setattr(module, "screen", lambda *_, **__: stands)
    still = SampledWalks(np.zeros(2), np.zeros(2))
    monkeypatch.setattr(module, "sample_walks", lambda robots, gaits, seed, coarse: [still])
    monkeypatch.setattr(module, "predict_lateral_stability", lambda *_: None)
    found = rank([], top)
    assert len(found.candidates) == top
    assert found.considered == top + sum(found.left_out.values()) == 10


def test_progress_goes_to_the_end_of_each_stage(ranked):
    stages = ranked[3]
    assert [s for s, share in stages if share == 1] == ["build filter", "all phases", "samples"]


def test_clamped_strips_hold_what_pins_let_fold():
    hourglass = design(*HOURGLASS, motors=(4,)).morphology
    assert "1 free mechanisms" in find_shape_fault(build(hourglass))
    assert find_shape_fault(build(hourglass, BuiltParameters.clamped())) == ""


def test_a_run_without_a_sound_design(tmp_path):
    found = rank([design(*TOWER), design(*WHEEL)], top=3)
    with raises(EldirError, "shortlist.empty", match=r"found 2 bodies: .*; evolve more, with .* --buildable"):
        write_shortlist(found, tmp_path / "shortlist")
    assert list(tmp_path.iterdir()) == []


def test_the_command_reads_a_run(tmp_path, capsys, monkeypatch):
    """From a run folder to files; the slow steps have their own tests."""
    config = EvolutionConfig(Lattice(4, 6), population=6, generations=1, max_active=2, iterations=2, seed=5)
    run = RunFolder.create(tmp_path / "run", config)
    go_on(run, run.restore())
    seen = []

    def ranked_at_once(designs, top, specification, *others):
        seen.append((len(designs), top, specification))
        return rank([design(*TOWER)], top)

    monkeypatch.setattr(module, "rank", ranked_at_once)
    with raises(EldirError, "shortlist.empty"):
        command(tmp_path / "run", tmp_path / "out", top=3)
    assert seen == [(6, 3, None)], "the kit, in which the run's springs replace the coil"
    assert not (tmp_path / "out").exists()


def test_the_command_takes_springs_and_tolerances_from_the_run(tmp_path, monkeypatch):
    springs, tolerances = SpringParameters(current_limit=3.45), RigTolerances(0.01, 0.08, 21.0, 23.0)
    PrintedRun.create(tmp_path / "run", PrintedEvolutionConfig(springs=springs, tolerances=tolerances))
    seen = []
    monkeypatch.setattr(designs_of_runs, "load_run", lambda _: [WALKER])
    monkeypatch.setattr(module, "rank", lambda *values: seen.append(values[-2:]) or Shortlist((), 0, {}))
    with raises(EldirError, "shortlist.empty"):
        command(tmp_path / "run", tmp_path / "out", top=3)
    assert seen == [(springs, tolerances)]


def test_own_coils_count_once(monkeypatch):
    """Those of the parts file, for all robots that walk."""
    kit = load_specification()
    wide = kit.model_copy(update={"coil": kit.coil.model_copy(update={"outer_diameter": 9.0})})
    seen = []

    def sampled(robots, gaits, seed, coarse):
        seen.append(robots.robot)
        return [SampledWalks(np.zeros(2), np.zeros(2))]

    def screened(bodies, printed, springs, **_):
        seen.append(RobotParameters(printed, springs))
        gait = Gait(30.0, np.array([0.0, 0.4]), np.array([0.2, 0.2]))
        return [ScreeningResult(0, 0.03, 0, np.array([0.5]), gait, True, "")]

    monkeypatch.setattr(module, "sample_walks", sampled)
    monkeypatch.setattr(module, "screen", screened)
    monkeypatch.setattr(module, "predict_lateral_stability", lambda *_: None)
    rank([WALKER], top=1, specification=wide)
    rank([WALKER], top=1, springs=spring_parameters(wide))
    assert [robot.printed.joints for robot in seen] == ["pins", "hubs"] * 2
    for robot in seen:
        assert robot.springs.coil_diameter == 8.25e-3 and robot.springs.current_limit == 3.6
        assert robot.printed.hot_stiffness == pytest.approx(124.0 * (6.5 / 8.25) ** 3)


def test_parts_go_before_the_springs_of_a_run_but_not_its_supply(tmp_path, monkeypatch):
    text = kit_file("parts.yaml").read_text().replace("outer_diameter: 7.25", "outer_diameter: 9.0")
    (tmp_path / "parts.yaml").write_text(text)
    springs = SpringParameters(current_limit=3.1, ambient=18.0, turns=20.0)
    PrintedRun.create(tmp_path / "run", PrintedEvolutionConfig(springs=springs))
    seen = []
    monkeypatch.setattr("eldir.evolution.designs.load_run", lambda _: [WALKER])
    monkeypatch.setattr(module, "rank", lambda *given: seen.append(given[-2]) or rank([design(*TOWER)]))
    for parts in (None, tmp_path / "parts.yaml"):
        with raises(EldirError, "shortlist.empty"):
            command(tmp_path / "run", tmp_path / "out", parts=parts)
    assert seen == [springs, SpringParameters(current_limit=3.1, ambient=18.0, coil_diameter=8.25e-3)]


def test_an_existing_folder_is_refused_before_anything_is_done(tmp_path):
    (tmp_path / "out").mkdir()
    with raises(EldirError, "file.exists"):
        command(tmp_path / "no-run", tmp_path / "out")


def test_a_missing_run_is_named(tmp_path):
    with raises(InputError, "file.missing", match=r"run\.json"):
        command(tmp_path / "no-run", tmp_path / "out")


@pytest.mark.parametrize("ground", [None, plane(0.1)], ids=["table", "slope"])
def test_what_evolved_with_a_gait_walks_in_it_and_falls_count(tmp_path, monkeypatch, ground):
    """No phases are searched; of two designs the one that falls in half of its samples comes last. Robots
    with hubs are coarse on a table alone."""
    evolved = Gait(20.0, np.array([0.0, 0.4]), np.array([0.3, 0.3]), "evolved")
    other = design("1111100", "1100111", "0100010", "0000000", motors=(17, 22))
    designs = [
        replace(d, provenance={"gait": evolved.to_json()}, printed_terrain=ground) for d in (WALKER, other)
    ]
    narrow = RigTolerances(0.01, 0.08, 21.0, 23.0)
    walks = {17 + 23: [2.0, -np.inf, 2.1, -np.inf], 17 + 22: [1.4, 1.5, 1.4, 1.5]}

    def sampled(robots, gaits, seed, coarse):
        assert coarse == (ground is None) and robots.terrain == ground and robots.tolerances == narrow
        assert [g.phase[1] for g in gaits] == [0.4]
        motors = int(np.flatnonzero(robots.morphology.active).sum())
        return [SampledWalks(np.array(walks[motors]), np.zeros(4))]

    monkeypatch.setattr(module, "sample_walks", sampled)
    monkeypatch.setattr(module, "screen", lambda *_, **__: pytest.fail("phases were searched"))
    monkeypatch.setattr(module, "check", lambda *_: BuildReport.of((), {}))
    monkeypatch.setattr(module, "walk", lambda *_, **__: 1.9)
    found = rank(designs, top=2, springs=SpringParameters(current_limit=3.45), tolerances=narrow)
    assert [c.spread.displacement.tolist() for c in found.candidates] == [walks[39], walks[40]]
    assert [c.gait.method for c in found.candidates] == ["evolved", "evolved"]
    rows = write_shortlist(found, tmp_path / "list")
    assert [r.predicted.sampled_walks.fell for r in rows] == [0, 2]
    assert rows[1].predicted.sampled_walks.expected == pytest.approx(1.025)
    assert read_gait(Design.load(tmp_path / "list" / rows[0].file)) == evolved


def test_of_robots_with_a_gait_those_that_differ_are_sampled_first(monkeypatch):
    """The second has the springs of the first and another motor: the third is looked at instead,
    unless the run knows that the second walks nearly as far."""
    evolved = {"gait": Gait(20.0, np.array([0.0, 0.4]), np.array([0.3, 0.3]), "evolved").to_json()}
    cousin = design("1111100", "1100111", "0100010", "0000000", motors=(17, 22))
    other = design(*BLOCK, motors=(40, 41))
    designs = [replace(d, provenance=evolved) for d in (WALKER, cousin, other)]
    sampled = []

    def walks(robots, *_, **__):
        sampled.append(next(k for k, d in enumerate(designs) if d.morphology == robots.morphology))
        return [SampledWalks(np.ones(4), np.zeros(4))]

    monkeypatch.setattr(module, "sample_walks", walks)
    monkeypatch.setattr(module, "check", lambda *_: BuildReport.of((), {}))
    monkeypatch.setattr(module, "walk", lambda *_, **__: 1.0)
    monkeypatch.setattr(module, "predict_lateral_stability", lambda *_: None)
    for top, looked_at in ((1, [0, 2]), (2, [0, 2, 1]), (3, [0, 2, 1])):
        sampled.clear()
        found = rank(designs, top=top, springs=SpringParameters(current_limit=3.45))
        assert sampled == looked_at and len(found.candidates) == top
    for expected, looked_at in ((1.9, [0, 1]), (1.7, [0, 2])):  # of the cousin in its run, the walker has 2.0
        known = [
            replace(d, provenance=d.provenance | {"evolved_walk": told(x)})
            for d, x in zip(designs, (2.0, expected, 1.0), strict=True)
        ]
        sampled.clear()
        rank(known, top=1, springs=SpringParameters(current_limit=3.45))
        assert sampled == looked_at


def told(expected):
    """A fitness of 0.1 below the expected walk: half a standard deviation of 0.2."""
    return {"expected": expected, "standard_error": 0.05, "samples": 16}


def test_the_shortlist_says_how_far_a_robot_leans(ranked):
    """The tipping angle from the height of the centre of mass, which changes by some per cent in the
    motion."""
    found, rows, _, _ = ranked
    stability = rows[0].predicted.lateral_stability
    assert stability == found.candidates[0].lateral
    robot = build(WALKER.morphology, BuiltParameters().with_hubs())
    height = robot.masses @ robot.positions[:, 1] / robot.masses.sum() + 6.93e-3
    assert stability.tipping_deg == pytest.approx(np.degrees(np.arctan2(24.7e-3, height)), rel=0.15)
    assert stability.lean_deg > 0 and stability.margin_deg < stability.tipping_deg
    assert rows[0].to_json()["predicted"]["lateral_stability"] == stability.to_json()


def test_wide_connectors_keep_a_robot_from_falling_over_sideways():
    gait, printer = Gait(20.0, np.array([0.0, 0.5]), np.full(2, 0.3)), load_printer()
    kit = fit_to_printer(load_specification(), printer)
    narrow, wide = (
        predict_lateral_stability(WALKER.morphology, gait, with_gap(kit, gap), printer, SpringParameters())
        for gap in (6, 80)
    )
    assert narrow.margin_deg < 0 and "may fall over sideways" in str(narrow)
    assert wide.is_safe and str(wide).startswith("leans sideways by ")
    one = RankedDesign(WALKER, BuildReport.of((), {}), None, gait, SampledWalks(np.zeros(2)), narrow)
    assert one.may_fall_sideways and not replace(one, lateral=wide).may_fall_sideways
    assert not replace(one, lateral=None).may_fall_sideways
    clamped = kit.model_copy(update={"strip": kit.strip.model_copy(update={"turn_deg": 0.0})})
    assert predict_lateral_stability(WALKER.morphology, gait, clamped, printer, SpringParameters()) is None
