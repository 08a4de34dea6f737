"""What films and model are worth to a robot that learns on the table: three ways to spend the same runs.

- *search*: no model. Bayesian optimisation on films alone: a Gaussian process over phase, period and pulse,
  and the expected improvement. `pip install scikit-learn`.
- *model*: no films. The gaits with the largest expected walks of the kit's robots, one after the other.
- *adapt*: both, `eldir adapt`, which makes all runs here, whatever they are expected to gain.

All begin with the gait of `eldir gait`, and end with the best filmed one. The first two play their gaits in
MuJoCo without camera and board (`HiddenRobot.walk`), which is as exact as the film. The best walk on each rig
is that of `benchmarks.headroom`, whose rows are in headroom.jsonl, or of any gait that was played.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.headroom import Search
from benchmarks.hidden_robot import Rows
from eldir.built.gait import Gait
from eldir.built.gait_search import nominal_robots
from eldir.built.samples import sample_walks
from eldir.built.screening import PHASES
from eldir.core.records import FloatArray
from eldir_calibration.adaptation.choice import expected_improvement
from eldir_calibration.adaptation.loop import adapt
from eldir_calibration.adaptation.runs import Adaptation, AdaptationConfig, AdaptationRun
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG
from eldir_hardware.planning.compiler import extract_gait
from eldir_hardware.planning.plan import heating_limits
from eldir_hardware.schedule import ActuationSchedule

TIMES = ((30.0, 6.0), (30.0, 5.1), (40.0, 6.0), (25.0, 3.8))
"""Periods and pulses [s] that search and model may choose, each with all phases: about those of
`eldir gait`."""
CYCLES = 2
"""Counted cycles of a gait that is played without a camera."""
FILMED_CYCLES = 3
"""Counted cycles of a filmed run: `eldir adapt` films five, which takes half as long again."""
_SAMPLES = 8  # of the kit's robots, as in the search of a gait
_AMPLITUDE, _LENGTH, _NOISE = 0.5, 1.0, 0.02  # of the Gaussian process: body lengths, features, body lengths
Play = Callable[[Gait], float]


def compare(designs: Sequence[Path], seeds: Sequence[int], runs: int, out: Path) -> None:
    """Print a table, and the coverage of the belief's intervals; the rows are kept in comparison.jsonl."""
    rows, rankings = Rows(out / "comparison.jsonl"), dict[Path, list[Gait]]()
    print("| design | rig | first gait | search | model | adapt | it would stop after run | best |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for design_file, seed in product(designs, seeds):
        row = rows.find(design_file, seed)
        if row is None:
            place = Search(design_file, seed, out / f"{design_file.stem}-{seed}")
            if design_file not in rankings:
                rankings[design_file] = _rank_by_model(place)
            best = Rows(out / "headroom.jsonl").find(design_file, seed)
            row = _compare_on_rig(place, rankings[design_file], runs, best or place.row())
            rows.add(row)
        print(_describe(row), flush=True)
    print(describe_coverage(rows.read()))


def _compare_on_rig(
    place: Search, ranked: Sequence[Gait], runs: int, headroom: dict[str, Any]
) -> dict[str, Any]:
    played: dict[bytes, float] = {}

    def play(gait: Gait) -> float:
        key = np.concatenate([[gait.period], gait.phase, gait.duty]).round(4).tobytes()
        if key not in played:
            walk = place.robot.walk(gait, CYCLES)
            played[key] = walk if math.isfinite(walk) else 0.0
        return played[key]

    adapted = _adapt(place, runs)
    folder = place.folder / "adapted"
    gaits = [extract_gait(ActuationSchedule.load(folder / run.schedule)) for run in adapted.runs]
    first = gaits[0]
    assert first is not None and adapted.best is not None
    candidates = _candidates(place)
    films = search_without_model(first, candidates, play, runs)
    model = [play(gait) for gait in [first, *(g for g in ranked if not g.is_near(first))][:runs]]
    last = gaits[adapted.best - 1]
    assert last is not None
    return {
        "design": str(place.design_file),
        "seed": place.seed,
        "first": play(first),
        "search": films,
        "model": model,
        "adapt": [play(gait) for gait in gaits if gait is not None],
        "last": play(last),
        "stops_after": _default_end(folder, adapted),
        "best": max(headroom["best"], *played.values()),
        "runs": [run.to_json() for run in adapted.runs],
    }


def _adapt(place: Search, runs: int) -> Adaptation:
    config = AdaptationConfig(runs=runs, cycles=FILMED_CYCLES, min_gain=0.0)
    return adapt(place.design_file, place.rig, place.folder / "adapted", place.drive, config)


def _default_end(folder: Path, adapted: Adaptation) -> int:
    """Number of runs after which the command's own threshold would have ended the adaptation."""
    for number, run in enumerate(adapted.runs[1:], start=1):
        text = ActuationSchedule.load(folder / run.schedule).predicted.choice or ""
        gain = re.search(r": ([\d.]+) body lengths", text)
        assert gain is not None, text
        if float(gain[1]) < AdaptationConfig().min_gain:
            return number
    return len(adapted.runs)


def _candidates(place: Search) -> list[Gait]:
    allowed, motors = heating_limits(place.rig).allowed, place.design.morphology.motors
    gaits = [
        Gait(period, np.array([0.0, phase / PHASES][:motors]), np.full(motors, pulse / period))
        for (period, pulse), phase in product(TIMES, range(PHASES if motors > 1 else 1))
    ]
    return [gait for gait in gaits if allowed(gait)]


def _rank_by_model(place: Search) -> list[Gait]:
    """The candidates from the largest expected walk of the kit's robots on; equal on all rigs of a design."""
    gaits = _candidates(place)
    robots = nominal_robots(place.design, heating_limits(place.rig))
    walks = sample_walks(robots, gaits, _SAMPLES, 1, cycles=1, coarse=True)
    return [gaits[i] for i in np.argsort([-one.expected for one in walks], kind="stable")]


def search_without_model(first: Gait, candidates: Sequence[Gait], play: Play, runs: int) -> list[float]:
    """Walks of the gaits that a Gaussian process chooses by expected improvement, after the first one. Its
    mean is that of the films, its other numbers are fixed: a few films cannot tell them."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern

    gaits, walks = [first], [play(first)]
    while len(walks) < runs:
        left = [gait for gait in candidates if not any(_is_same(gait, other) for other in gaits)]
        kernel = ConstantKernel(_AMPLITUDE**2) * Matern(_LENGTH, nu=2.5)
        process = GaussianProcessRegressor(kernel, alpha=_NOISE**2, optimizer=None)
        mean = float(np.mean(walks))
        process.fit(np.array([_features(gait) for gait in gaits]), np.array(walks) - mean)
        expected, deviation = process.predict(np.array([_features(gait) for gait in left]), return_std=True)
        gains = [
            expected_improvement(mean + e, d, max(walks)) for e, d in zip(expected, deviation, strict=True)
        ]
        gaits.append(left[int(np.argmax(gains))])
        walks.append(play(gaits[-1]))
    return walks


def _features(gait: Gait) -> FloatArray:
    """A point for each gait, such that gaits at a distance of about one are unlike."""
    turn = 2 * np.pi * (gait.phase[1:] - gait.phase[0])
    return np.concatenate([np.cos(turn), np.sin(turn), [gait.period / 20.0], gait.duty * gait.period / 3.0])


def _is_same(gait: Gait, other: Gait) -> bool:
    return bool(np.allclose(_features(gait), _features(other), atol=1e-3))


def describe_coverage(rows: Sequence[dict[str, Any]]) -> str:
    """How many filmed walks lie within their 95 % intervals, for predictions from two and more films."""
    runs = [AdaptationRun.from_json(run) for row in rows for run in row["runs"][2:]]
    known = [run for run in runs if run.predicted is not None and run.deviation is not None]
    within = sum(
        abs((0.0 if run.has_fallen else run.filmed) - run.predicted)
        <= DEFAULT_CONFIG.interval * run.deviation
        for run in known
        if run.predicted is not None and run.deviation is not None
    )
    return f"\nIntervals after the second run: {within} of {len(known)} films within."


def _describe(row: dict[str, Any]) -> str:
    ways = [f"{max(row[way]):+.2f}" for way in ("search", "model")]
    return (
        f"| {row['design']} | {row['seed']} | {row['first']:+.2f} | {' | '.join(ways)} | {row['last']:+.2f} "
        f"| {row['stops_after']} | {row['best']:+.2f} |"
    )
