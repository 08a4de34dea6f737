"""Benchmarks: what they measure and how, not how fast it is."""

import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from benchmarks import coarse_robots
from eldir.benchmark import built, device, skips, speed
from eldir.benchmark.measurement import big, limit_threads, ratio, save, small, time_in_turns
from eldir.built.gait import FreeLengths, free_lengths
from eldir.built.robot import build
from eldir.built.samples import NominalRobots
from eldir.built.walking import displacements
from eldir.engine.device.records import DeviceResult
from eldir.morphology import Morphology
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir_calibration.transfer.mujoco_walks import walk_given_robot
from tests.eldir.built.braced_robots import bodies
from tests.paths import SCHEMAS


def test_ways_take_turns_and_the_first_call_does_not_count() -> None:
    calls, now = [], [0.0]

    def way(name: str, seconds: list[float]) -> None:
        calls.append(name)
        now[0] += seconds[calls.count(name) - 1]

    ways = {"a": lambda: way("a", [9, 1, 2, 3]), "b": lambda: way("b", [9, 2, 4, 12])}
    seconds = time_in_turns(ways, 3, clock=lambda: now[0])
    assert calls == ["a", "b"] * 4
    assert seconds["a"].tolist() == [1, 2, 3] and seconds["b"].tolist() == [2, 4, 12]
    assert ratio(seconds, "b", "a") == 2


def test_populations_are_what_they_are_called() -> None:
    springs = [np.mean([len(body.springs) for body in population(64)]) for population in (big, small)]
    assert abs(springs[0] - 176) < 12 and abs(springs[1] - 63) < 2
    assert all((a.springs == b.springs).all() for a, b in zip(small(3), small(3), strict=True))


def test_threads_are_set_for_a_while(monkeypatch) -> None:
    monkeypatch.setenv("ELDIR_THREADS", "3")
    from eldir.engine import threads

    with limit_threads(2):
        assert threads.worker_threads() == 2
    assert threads.worker_threads() == 3


def test_speed_is_written_as_its_schema_says(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(speed, "POPULATIONS", {"big": lambda n: small(2), "small": lambda n: small(1)})
    monkeypatch.setattr(speed, "Scene", lambda: _SHORT)
    monkeypatch.setattr(speed, "memory", lambda n: dict.fromkeys(_MEMORY, float(n)))
    monkeypatch.setattr(speed, "first_use", lambda: dict.fromkeys(("compiled", "cached"), _START))
    said: list[str] = []
    values = speed.measure(True, said.append)
    save(tmp_path / "out", "speed", values, speed.plot(values))
    written = json.loads((tmp_path / "out" / "speed.json").read_text())
    jsonschema.validate(written, json.loads((SCHEMAS / "benchmark-speed.schema.json").read_text()))
    assert (tmp_path / "out" / "speed.png").read_bytes().startswith(b"\x89PNG")
    assert len(said) == 5
    values["big"]["iterations_per_s"], values["scaling"] = 350.0, {"1": 1.0, "2": 1.6, "4": 1.25}
    printed = speed.describe(values)
    assert "1000 big robots learn 35 iterations in 100 s on one thread, in 62 s on 2 threads." in printed
    assert "compiles for 2.0 s; later starts are ready after 3.0 s" in printed
    assert "gain nothing" in speed.describe(values | {"scaling": {"1": 1.0, "2": 0.9}})


def test_the_speed_of_a_device_is_written_as_its_schema_says(tmp_path: Path, monkeypatch) -> None:
    """With times of 0.1 ms for each robot-iteration and a second for every call."""
    monkeypatch.setattr(device, "POPULATIONS", {"big": lambda n: small(2), "small": lambda n: small(1)})
    monkeypatch.setattr(device, "chosen_device", lambda: "cuda")
    monkeypatch.setattr(device, "device_label", lambda: "a GPU")
    monkeypatch.setattr(device, "_seconds", lambda t: 1 + 1e-4 * len(t.sizes) * t.settings.iterations)
    losses = np.array([[0.0, -1.0], [0.0, -3.0]])
    result = DeviceResult(losses, np.full(2, -1), np.zeros(1), np.ones((2, 2)))
    monkeypatch.setattr(device, "compute", lambda task: result._replace(best=task.weights))
    said: list[str] = []
    values = device.measure(True, said.append)
    save(tmp_path / "out", "device", values, device.plot(values))
    written = json.loads((tmp_path / "out" / "device.json").read_text())
    jsonschema.validate(written, json.loads((SCHEMAS / "benchmark-device.schema.json").read_text()))
    assert written["big"] == {"robots": [128, 512], "iterations_per_s": [10_000.0, 10_000.0]}
    assert written["generation"]["mean_loss_m"] == -2.0 and len(said) == 6
    printed = device.describe(values)
    assert "fully used from 128 big robots" in printed and "diverged" not in printed


def test_skips_are_written_as_their_schema_says(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(skips, "big", lambda n: small(1))
    monkeypatch.setattr(skips, "Scene", lambda: _SHORT)
    values = skips.measure(True, lambda line: None)
    save(tmp_path / "out", "skips", values, skips.plot(values))
    written = json.loads((tmp_path / "out" / "skips.json").read_text())
    jsonschema.validate(written, json.loads((SCHEMAS / "benchmark-skips.schema.json").read_text()))
    assert set(written["skips"]) > set(skips.CASES)
    assert written["machine"]["other_programs"] is None
    assert "Results are the same with every shortcut" in skips.describe(values)
    for row in values["skips"].values():
        row["gain"] = 1.5  # on a busy machine some gain nothing
    values["skips"]["no contact in free flight"] = {"gain": 0.9, "difference": {"loss": 2e-3, "status": 0.0}}
    printed = skips.describe(values)
    assert "FAULT: results differ by more than rounding with: no contact in free flight." in printed
    assert "No gain on this machine: no contact in free flight." in printed and "loss 2e-03 m" in printed


_SHORT = speed.Scene().replace(steps=100)  # on a busy machine too, learning takes longer than moving
_MEMORY = ("robots", "engine_gb", "bodies_gb", "peak_gb")
_START = {"start_s": 1.0, "kernel_s": 2.0}


def test_built_is_written_as_its_schema_says(tmp_path: Path, monkeypatch) -> None:
    hubs, pins = built.Simplification(True, 1, 20e3, 0.1, 9.0), built.Simplification(False, 1, 20e3)
    ways = {built.EXACT: hubs, "pins": pins}
    monkeypatch.setattr(built, "SIMPLIFICATIONS", ways)
    monkeypatch.setattr(built, "walkers", lambda: _WALKERS[6:8])
    others = {"the same": _walk_in_the_engine, "farther": lambda *sample: 0.5 + _walk_in_the_engine(*sample)}
    values = built.measure(True, lambda line: None, others)
    save(tmp_path / "out", "built", values, built.plot(values))
    written = json.loads((tmp_path / "out" / "built.json").read_text())
    jsonschema.validate(written, json.loads((SCHEMAS / "benchmark-built.schema.json").read_text()))
    exact, pins = written["ways"].values()
    assert exact["rms_difference"] == 0 < pins["rms_difference"] and values["robots"] == 2
    assert written["heat_s"] < pins["seconds_per_walk"] < exact["seconds_per_walk"]
    same, farther = written["others"].values()
    assert same["samples"] == 1 and same["mean_difference"] == same["rms_difference"] == 0
    assert farther["mean_difference"] == farther["rms_difference"] == 0.5
    values["ways"]["pins"] |= {"rms_difference": 0.04, "seconds_per_walk": exact["seconds_per_walk"] / 4}
    printed = built.describe(values)
    assert "'pins' is the fastest: 4.0 times as fast" in printed and "its difference is no error" in printed


def _walk_in_the_engine(body: Morphology, sample: RobotParameters, table: FreeLengths, cycles: int) -> float:
    return float(displacements([build(body, sample)], [table], cycles, RobotParameters().free_lengths)[0])


def test_a_sample_walks_in_mujoco_about_as_far_as_in_the_engine() -> None:
    """`docs/reference/evolving-for-building.md` has the difference for nine robots."""
    pytest.importorskip("mujoco")
    walker = _WALKERS[0]
    nominal = RobotParameters(BuiltParameters().with_hubs())
    (sample,) = NominalRobots(walker.body, nominal).samples(1, 3)
    table = free_lengths(
        walker.gait, sample.motor_springs(walker.body.motors), 1, hubs=walker.body.motor_hubs
    )
    walks = [walk(walker.body, sample, table, 1) for walk in (walk_given_robot, _walk_in_the_engine)]
    assert min(walks) > 0.3 and abs(walks[0] - walks[1]) < 0.3


def test_the_robots_of_the_built_benchmark_walk() -> None:
    assert len(_WALKERS) == 9
    for walker in _WALKERS[::3]:
        assert built.mean_walk(walker, built.Simplification(False, 1, 20e3)) > 0.5


_WALKERS = built.walkers()


def test_coarse_robots_are_compared_with_the_robots_as_they_are() -> None:
    robots, seeds = built.walkers()[:2], (3, 4)
    exact, soft = built.Simplification(False, 1), built.Simplification(False, 1, 20e3)
    spent, walks = coarse_robots.measure(soft, robots, seeds)
    assert walks.shape == (2, 2) and spent > 0
    assert walks[1, 0] == built.mean_walk(robots[0], soft, 4) != built.mean_walk(robots[0], exact, 4)


def test_what_the_benchmark_calls_coarse_is_what_the_product_does() -> None:
    values = built.SIMPLIFICATIONS["hubs, coarse, 5 cycles"]
    robot = build(bodies(1, 3)[0], BuiltParameters().with_hubs())
    assert robot.coarse() == robot.coarse(values.tension, values.damping, values.inertia) != robot
