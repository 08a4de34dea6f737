"""Films in another air and with another current: what they tell of the next run."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from eldir.built.gait_search import nominal_robots
from eldir.built.samples import IdentifiedRobots, sample_walks, simulate_most_probable
from eldir.built.scene import PrintedScene
from eldir.errors import EldirError
from eldir_calibration.adaptation.choice import discrepancy
from eldir_calibration.adaptation.films import FilmedWalk, filmed_walks, read_run
from eldir_calibration.adaptation.loop import adapt
from eldir_calibration.adaptation.runs import Adaptation
from eldir_hardware.planning.compiler import extract_gait
from eldir_hardware.planning.plan import heating_limits
from eldir_hardware.schedule import ActuationSchedule
from tests.calibration.adaptation.hidden_bench import Bench
from tests.calibration.adaptation.short_adaptation import FEW


def test_with_another_current_the_error_of_earlier_films_counts(bench: Bench) -> None:
    """Until there is a film with this current. The robots are those of a supply that is set otherwise."""
    scene = PrintedScene.load(bench.folder / "out" / "run_02" / "belief.json")
    film, own = scene.filmed_gaits[0], bench.rig.supply.current_limit_a
    weaker = replace(scene.springs, current_limit=scene.springs.current_limit / 1.1)
    (walk,) = simulate_most_probable(
        IdentifiedRobots.of(bench.design, replace(scene, springs=weaker)), [film.gait], coarse=True
    )
    earlier = [FilmedWalk(film, own)]
    assert discrepancy(bench.design, scene, earlier, 1.1 * own) == pytest.approx(
        ((walk - film.walked) / 2, abs(walk - film.walked)), abs=2e-3
    )
    now = [*earlier, FilmedWalk(film, 1.1 * own)]
    assert discrepancy(bench.design, scene, now, 1.1 * own) == discrepancy(bench.design, scene, earlier, own)


def test_a_walk_is_compared_in_the_air_of_its_film(bench: Bench) -> None:
    """The belief holds for the air of the last run, and another run may have been in colder air."""
    scene = PrintedScene.load(bench.folder / "out" / "run_02" / "belief.json")
    film, own = scene.filmed_gaits[0], bench.rig.supply.current_limit_a
    colder = replace(scene.springs, ambient=scene.springs.ambient - 4.0)
    walks = [
        simulate_most_probable(IdentifiedRobots.of(bench.design, one), [film.gait], coarse=True)[0]
        for one in (scene, replace(scene, springs=colder))
    ]
    assert abs(walks[0] - walks[1]) > 0.02
    there, here = FilmedWalk(film, own, colder.ambient), FilmedWalk(film, own, scene.springs.ambient)
    for filmed, walk in ((here, walks[0]), (there, walks[1])):
        expected = (walk - film.walked) / 2, abs(walk - film.walked)
        assert discrepancy(bench.design, scene, [filmed], own) == pytest.approx(expected, abs=1e-6)
    bias, _ = discrepancy(bench.design, scene, [here, there], own)
    assert bias == pytest.approx((sum(walks) - 2 * film.walked) / 3, abs=1e-6)
    assert discrepancy(bench.design, scene, [here], own) == discrepancy(
        bench.design, scene, [FilmedWalk(film, own)], own
    )


def test_films_know_their_air(bench: Bench) -> None:
    out = bench.folder / "out"
    film = read_run(out / "run_01" / "run_01.mcap", bench.design, bench.rig, lambda what, part: None)
    for room, air in ((None, bench.rig.springs.ambient_c), (18.5, 18.5)):
        (walk,) = filmed_walks([film._replace(rooms_c=(room,))])
        assert walk.air_c == air and walk.current_limit_a == bench.rig.supply.current_limit_a


@pytest.mark.parametrize("with_prior", [False, pytest.param(True, marks=pytest.mark.stress)])
def test_the_first_run_is_planned_for_the_air_that_was_measured(bench: Bench, with_prior: bool) -> None:
    """Its walk is that of the samples in that air, with what another robot tells or without."""
    first, out = bench.folder / "out", bench.folder / f"cold_{with_prior}"
    planned: list[ActuationSchedule] = []

    def drive(schedule: ActuationSchedule, log: Path) -> None:
        planned.append(schedule)
        raise EldirError("nothing is driven")

    rig, prior = bench.rig, [first] if with_prior else []
    with pytest.raises(EldirError, match="nothing is driven"):
        adapt(bench.design_file, rig, out, drive, FEW, prior=prior, room_c=18.0)
    springs = replace(rig.spring_parameters(), ambient=18.0)
    robots = nominal_robots(bench.design, replace(heating_limits(rig), springs=springs))
    if with_prior:
        told = PrintedScene.load(out / "prior.json")
        assert told.springs.ambient == rig.springs.ambient_c, "it is that of all runs"
        colder = replace(told, springs=replace(told.springs, ambient=18.0))
        assert PrintedScene.load(out / "run_01" / "belief.json") == colder
        robots = IdentifiedRobots.of(bench.design, colder)
    (cold,) = planned
    gait, walk = extract_gait(cold), cold.predicted.walk
    assert gait is not None and walk is not None
    assert walk != ActuationSchedule.load(first / "run_01" / "schedule.json").predicted.walk
    (walks,) = sample_walks(robots, [gait], FEW.samples, FEW.seed)
    assert walk.mean == pytest.approx(walks.mean, abs=1e-6)


def test_a_later_run_is_planned_for_the_air_that_was_measured(bench: Bench) -> None:
    """Not for that of the last film."""
    out = bench.folder / "warm"
    shutil.copytree(bench.folder / "out", out)

    def drive(schedule: ActuationSchedule, log: Path) -> None:
        raise EldirError("nothing is driven")

    with pytest.raises(EldirError, match="nothing is driven"):
        config = replace(FEW, runs=3, min_gain=0.0)
        adapt(bench.design_file, bench.rig, out, drive, config, room_c=27.0)
    last, planned = (PrintedScene.load(out / f"run_0{n}" / "belief.json") for n in (2, 3))
    assert last.springs.ambient == bench.rig.springs.ambient_c
    assert planned.springs.ambient == 27.0


def test_one_film_tells_half_of_what_is_predicted_too_much(bench: Bench) -> None:
    out = bench.folder / "out"
    runs = Adaptation.load(out / "adaptation.json").runs
    scene = PrintedScene.load(out / "run_02" / "belief.json")
    (walk,) = simulate_most_probable(
        IdentifiedRobots.of(bench.design, scene), [scene.filmed_gaits[0].gait], coarse=True
    )
    films = [FilmedWalk(film, bench.rig.supply.current_limit_a) for film in scene.filmed_gaits]
    bias, error = discrepancy(bench.design, scene, films, bench.rig.supply.current_limit_a)
    assert bias == pytest.approx((walk - runs[0].filmed) / 2, abs=1e-4) and error == pytest.approx(
        abs(2 * bias)
    )
    planned = ActuationSchedule.load(out / runs[1].schedule).predicted.walk
    assert planned is not None and runs[1].predicted == pytest.approx(planned.expected - bias, abs=1e-4)
