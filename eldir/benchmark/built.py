"""`eldir benchmark built`: run time of a walk of the printed robot against the error of its simplifications.

Robots that walk, each with its gait, are simulated with pins or hubs, real or soft strips, one or five
cycles, and with more inertia. The error is the difference of the mean walk of eight samples from that with
hubs, real strips and five cycles: samples are the same in all, so it is the simplification's alone. Walks of
robots that fall, or that hardly move, would tell little about robots that walk.

Another physics, such as MuJoCo's, takes much longer. It walks the first samples of each robot once, and is
compared with the exact walks of the same samples.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from eldir.benchmark.measurement import limit_threads, time_in_turns
from eldir.benchmark.tables import text_table
from eldir.built.gait import FreeLengths, Gait, free_lengths_batch
from eldir.built.robot import COARSE_DAMPING, COARSE_INERTIA, SOFT_TENSION, build
from eldir.built.samples import NominalRobots
from eldir.built.walking import displacements
from eldir.evolution.printed.trials import count_falls_as_zero
from eldir.genotype import Genotype
from eldir.lattice import Lattice
from eldir.morphology import Morphology, develop
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.terrain import Terrain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Say = Callable[[str], None]
WalkSample = Callable[[Morphology, RobotParameters, FreeLengths, int], float]
"""The walk of one sample of a robot in another physics, under prescribed free lengths, over so many counted
cycles [body lengths per five cycles]; minus infinity where it falls."""
_SAMPLES = 8
_OTHER_SAMPLES = 2
_SEED = 4711
_FEW = 3  # robots of a quick measurement
REAL = BuiltParameters.tension
EXACT = "hubs, 5 cycles"


class BenchmarkRobot(NamedTuple):
    """A printed robot that walks, and how."""

    body: Morphology
    gait: Gait


class Simplification(NamedTuple):
    """How the printed robot is simulated."""

    hubs: bool
    cycles: int
    """Counted cycles."""
    tension: float = REAL
    """Largest stiffness of the strips in tension [N/m]; this and the next two as in `PrintedRobot.coarse`."""
    damping: float = 1.0
    """Share of the damping of strips between hubs."""
    inertia: float = 1.0
    """Factor on the inertia of robots with hubs."""


def _coarse(hubs: bool, cycles: int) -> Simplification:
    """What `PrintedRobot.coarse` does."""
    return Simplification(hubs, cycles, SOFT_TENSION, COARSE_DAMPING, COARSE_INERTIA)


SIMPLIFICATIONS = {
    EXACT: Simplification(True, 5),
    "hubs, inertia x 4, 5 cycles": Simplification(True, 5, inertia=4.0),
    "hubs, strips of 20 kN/m, 5 cycles": Simplification(True, 5, 20e3),
    "hubs, coarse, 5 cycles": _coarse(True, 5),
    "hubs, 1 cycle": Simplification(True, 1),
    "hubs, coarse, 1 cycle": _coarse(True, 1),
    "pins, 5 cycles": Simplification(False, 5),
    "pins, 1 cycle": Simplification(False, 1),
    "pins, coarse, 1 cycle": _coarse(False, 1),
}
"""What is compared, the exact one first."""


def walkers() -> list[BenchmarkRobot]:
    """Elites of the demo, which walk 1.1 to 1.8 body lengths in five cycles."""
    held = json.loads(files("eldir.benchmark").joinpath("walkers.json").read_text())
    lattice = Lattice(*held["lattice"])
    return [_walker(lattice, **{k: v for k, v in w.items() if k != "source"}) for w in held["walkers"]]


def _walker(
    lattice: Lattice,
    triangles: Sequence[tuple[int, int]],
    motors: Sequence[int],
    period_s: float,
    duty: float,
    phase: Sequence[float],
) -> BenchmarkRobot:
    mask = np.zeros((lattice.rows, lattice.columns), bool)
    mask[tuple(np.transpose(triangles))] = True
    springs = np.isin(np.arange(len(lattice.springs)), motors)
    gait = Gait(period_s, np.array(phase), np.full(len(phase), duty))
    return BenchmarkRobot(develop(lattice, Genotype(mask, springs)), gait)


def measure(quick: bool, say: Say, others: Mapping[str, WalkSample] | None = None) -> dict[str, Any]:
    """Measure all figures; `say` is called with a line after each part. `others` are other physics, by
    name."""
    robots, turns = (walkers()[:_FEW], 1) if quick else (walkers(), 3)
    walks = {name: np.full(len(robots), np.nan) for name in SIMPLIFICATIONS}
    seconds = {name: np.zeros(turns) for name in SIMPLIFICATIONS}
    heating = np.zeros(turns)
    with limit_threads(1):
        for r, robot in enumerate(robots):
            # The warm-up call is the one that is compared: results do not depend on the turn.
            found = time_in_turns(
                {
                    name: _remembering(walks[name], r, robot, variant)
                    for name, variant in SIMPLIFICATIONS.items()
                }
                | {"heat": lambda robot=robot: _heated(robot, RobotParameters(), 1)},
                turns,
                time.process_time,
            )
            heating += found.pop("heat") / (_SAMPLES * len(robots))
            for name, spent in found.items():
                seconds[name] += spent / (_SAMPLES * len(robots))
            say(f"{r + 1} of {len(robots)} robots")
    rows = {name: _row(walks[name], walks[EXACT], seconds[name]) for name in SIMPLIFICATIONS}
    samples = 1 if quick else _OTHER_SAMPLES
    other_rows = {}
    for name, walk in (others or {}).items():
        say(f"{name}: {len(robots) * samples} walks")
        other_rows[name] = _compare_other(walk, robots, samples)
    return {
        "robots": len(robots),
        "samples": _SAMPLES,
        "turns": turns,
        "heat_s": round(float(np.median(heating)), 5),
        "ways": rows,
        "others": other_rows,
    }


_GOOD = 0.05
"""A root mean square difference [body lengths per five cycles] that no choice between robots notices."""


def describe(values: dict[str, Any]) -> str:
    """A table, and which simplification is worth taking."""
    ways, others = values["ways"], values["others"]
    rows = [
        [
            name,
            f"{row['seconds_per_walk']:.3g}",
            f"{row['walks_per_s']:.3g}",
            "" if name == EXACT else f"{row['mean_difference']:+.2f}",
            "" if name == EXACT else f"{row['rms_difference']:.2f}",
        ]
        for name, row in (ways | others).items()
    ]
    table = text_table(
        ["samples with", "s a walk", "walks a second", "mean difference", "rms difference"], rows
    )
    exact = ways[EXACT]
    good = [name for name, row in ways.items() if row["rms_difference"] <= _GOOD]
    best = min(good, key=lambda name: ways[name]["seconds_per_walk"])
    times = exact["seconds_per_walk"] / ways[best]["seconds_per_walk"]
    verdict = [
        f"Differences are from {EXACT!r} [body lengths per five cycles], over {values['robots']} robots.",
        f"Within {_GOOD:g} of it, {best!r} is the fastest: {times:.1f} times as fast.",
        f"Heating alone takes {values['heat_s']:.2g} s a walk.",
    ]
    if others:
        verdict.append(
            "Another physics models joints, strips and contacts differently: its difference is no error."
        )
    return "\n".join([table, "", *verdict])


def _remembering(
    kept: np.ndarray, r: int, robot: BenchmarkRobot, variant: Simplification
) -> Callable[[], object]:
    def run() -> None:
        kept[r] = mean_walk(robot, variant)

    return run


def mean_walk(
    robot: BenchmarkRobot, variant: Simplification, seed: int = _SEED, terrain: Terrain | None = None
) -> float:
    """Mean walk of the samples of a seed, a fall counted as no walk [body lengths per five cycles].
    `terrain`: the ground, by default a table."""
    printed = BuiltParameters()
    nominal = RobotParameters(printed.with_hubs() if variant.hubs else printed)
    samples, tables = _heated(robot, nominal, variant.cycles, seed)
    simpler = variant.tension, variant.damping, variant.inertia
    built = [build(robot.body, s).coarse(*simpler) for s in samples]
    walks = displacements(built, tables, variant.cycles, nominal.free_lengths, terrain=terrain)
    return float(count_falls_as_zero(walks).mean())


def _compare_other(walk: WalkSample, robots: Sequence[BenchmarkRobot], samples: int) -> dict[str, float]:
    """Time and error of another physics: the first samples of each robot walk once."""
    variant = SIMPLIFICATIONS[EXACT]
    nominal = RobotParameters(BuiltParameters().with_hubs() if variant.hubs else BuiltParameters())
    walks, exact, spent = np.zeros((len(robots), samples)), np.zeros((len(robots), samples)), 0.0
    with limit_threads(1):
        for r, robot in enumerate(robots):
            own, tables = _heated(robot, nominal, variant.cycles)
            own, tables = own[:samples], tables[:samples]
            built = [build(robot.body, s) for s in own]
            exact[r] = displacements(built, tables, variant.cycles, nominal.free_lengths)
            began = time.process_time()
            _heated(robot, nominal, variant.cycles)
            heat = (time.process_time() - began) / _SAMPLES
            began = time.process_time()
            walks[r] = [
                walk(robot.body, s, table, variant.cycles) for s, table in zip(own, tables, strict=True)
            ]
            spent += (time.process_time() - began) / samples + heat
    mean, exact_mean = (count_falls_as_zero(each).mean(axis=1) for each in (walks, exact))
    return {"samples": samples, **_row(mean, exact_mean, np.array([spent / len(robots)]))}


def _heated(
    robot: BenchmarkRobot, nominal: RobotParameters, cycles: int, seed: int = _SEED
) -> tuple[list[RobotParameters], list[FreeLengths]]:
    """The samples of a robot, and the free lengths of their springs."""
    samples = NominalRobots(robot.body, nominal).samples(_SAMPLES, seed)
    heated = [(robot.gait, s.motor_springs(robot.body.motors)) for s in samples]
    return samples, free_lengths_batch(heated, cycles, hubs=[robot.body.motor_hubs] * len(heated))


def _row(walks: np.ndarray, exact: np.ndarray, seconds: np.ndarray) -> dict[str, float]:
    off = walks - exact
    spent = float(np.median(seconds))
    return {
        "seconds_per_walk": round(spent, 5),
        "walks_per_s": round(1 / spent, 2),
        "mean_difference": round(float(off.mean()), 3),
        "rms_difference": round(float(np.sqrt((off**2).mean())), 3),
    }


def plot(values: dict[str, Any]) -> Figure:
    """Error against processor time, every simplification by its name."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.5, 4), layout="constrained")
    axes = figure.subplots()
    for (name, row), marker in zip(values["ways"].items(), "oDs^vPXoDs^", strict=False):
        hubs = name.startswith("hubs")
        colour, fill = ("tab:blue", "full") if hubs else ("tab:orange", "none")
        at = row["seconds_per_walk"], row["rms_difference"]
        axes.plot(*at, marker, ms=8, label=name, color=colour, fillstyle=fill)
    for (name, row), marker in zip(values["others"].items(), "*hd", strict=False):
        at = row["seconds_per_walk"], row["rms_difference"]
        label = f"{name} ({row['samples']} samples)"
        axes.plot(*at, marker, ms=10, label=label, color="black", ls="none")
    figure.legend(loc="outside right upper", fontsize=8)
    axes.axvline(values["heat_s"], color="grey", lw=0.8)
    axes.annotate("heat alone", (values["heat_s"], 0.98), xycoords=("data", "axes fraction"), rotation=90,
                  va="top", ha="right", fontsize=8, color="grey")  # fmt: skip
    axes.set(
        xscale="log",
        xlabel="processor time of a walk [s]",
        ylabel="root mean square difference of the mean walk\n[body lengths per five cycles]",
        title=f"Printed robots: {values['robots']} that walk, {values['samples']} samples each, one thread",
    )
    axes.margins(x=0.1, y=0.12)
    return figure
