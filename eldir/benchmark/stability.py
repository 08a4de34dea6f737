"""`eldir benchmark stability`: where simulations diverge, compared with the predicted limit.

It measures a map over stiffness, step, damping, actuation, precision, horizon and slope of the ground, with
the limit that `eldir.engine.stable_step` predicts; extreme bodies and states; and random robots that learn.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from eldir.benchmark.measurement import big
from eldir.benchmark.tables import text_table
from eldir.core.kernels import Precision
from eldir.core.records import BoolArray
from eldir.engine.stable_step import stable_step
from eldir.engine.validity import OK, REFUSED
from eldir.evolution.paper.population import is_valid
from eldir.genotype import Genotype
from eldir.lattice import Lattice
from eldir.learning import learn
from eldir.morphology import Morphology, develop
from eldir.rollout import Rollout, simulate, simulate_one
from eldir.scene import Scene
from eldir.terrain import Terrain
from eldir.training.configuration import TrainingConfig
from eldir.training.loop import initial_controllers

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHAPES: dict[str, list[tuple[int, int]]] = {
    "triangle": [(0, 1)],
    "hinge": [(0, 1), (1, 1)],
    "beam": [(0, column) for column in range(22)],
    "tower": [(row, 5) for row in range(13)],
    "lattice": [(row, column) for row in range(13) for column in range(22)],
}
PARTS = (0.7, 0.9, 0.97, 1.03, 1.1, 1.4)
"""Steps, relative to the largest stable one."""
_FASTEST = 10.0  # times the stiffness' root [m/s]; the paper's robots stay below 0.1 of it


def extreme_bodies() -> dict[str, Morphology]:
    """One triangle, two on a hinge, a 22-long beam, a tower, the whole lattice; none and all active;
    two masses in one place; springs that expand at once without limit; a body half in the ground."""
    found = {name: body_of(cells) for name, cells in SHAPES.items()}
    few = body_of([(0, 1), (0, 2), (0, 3), (1, 3)])
    found["no active spring"] = replace(few, active=np.zeros(len(few.springs), bool))
    found["all active"] = replace(few, active=np.ones(len(few.springs), bool))
    merged = few.positions.copy()
    merged[1] = merged[0]
    found["coincident masses"] = replace(few, positions=merged)
    found["bursting"] = replace(found["hinge"], rest_lengths=np.full(len(found["hinge"].springs), 1e30))
    found["in the ground"] = replace(few, positions=few.positions - np.array([0, 0.09]))
    return found


def body_of(cells: list[tuple[int, int]]) -> Morphology:
    """Triangles by row and column on the paper's lattice, half of the springs active."""
    lattice, mask = Lattice(), np.zeros((13, 22), bool)
    mask[tuple(np.array(cells).T)] = True
    return develop(lattice, Genotype(mask, _half(lattice, mask)))


def _half(lattice: Lattice, mask: BoolArray) -> BoolArray:
    active = np.random.default_rng(0).random(len(lattice.springs)) < 0.5
    active[np.flatnonzero(lattice.expressed_springs(mask))[0]] = True
    return active


def extreme_grounds(scene: Scene) -> dict[str, Scene]:
    """Flat with and without slip, rugged, a slope of 72 degrees, and one ridge."""
    steep = Terrain.from_segments(np.array([-1.0, 0.1]), np.array([0.0, 3.0]), np.array([0.1, -0.2]))
    ridge = Terrain.from_segments(np.array([-1.0, 0.05]), np.array([0.5, -0.5]), np.array([0.075, 0.125]))
    return {
        "no slip": scene,
        "friction": scene.replace(contact="friction"),
        "rugged": scene.replace(terrain=Terrain.rugged(np.random.default_rng(1))),
        "steep": scene.replace(terrain=steep),
        "ridge": scene.replace(terrain=ridge),
    }


Say = Callable[[str], None]


def measure(quick: bool, say: Say) -> dict[str, Any]:
    """Measure all figures; `say` is called with a line before each part."""
    say("1 of 3: runs on both sides of the predicted limit")
    points = border(quick)
    values: dict[str, Any] = {"map": points, "agreement": agreement(points)}
    say("2 of 3: extreme bodies on extreme grounds")
    values["edge"] = edge()
    robots = 200 if quick else 10_000
    say(f"3 of 3: {robots} random robots learn")
    values["random"] = random_robots(robots)
    return values


def describe(values: dict[str, Any]) -> str:
    """Tables, and whether the predicted limit and the flags can be trusted."""
    shares, found = values["agreement"], values["random"]
    limit = text_table(
        [f"stable runs ({len(values['map'])} settings)", "below the limit [%]", "above the limit [%]"],
        [
            [f"{kind} robots", *(f"{100 * shares[f'{kind} {side}']:.1f}" for side in ("below", "above"))]
            for kind in ("passive", "acting")
        ],
    )
    reasons = text_table(
        [f"discarded of {found['robots']} random robots", "robots"],
        [[reason, str(count)] for reason, count in found["why"].items()],
    )
    unflagged = [case for case in values["edge"] if not case["flagged"]]
    dependent = [case for case in values["edge"] if not case["alone"]]
    return "\n".join([
        limit, "", reasons, "",
        _judge_limit(values["map"]),
        _judge_cases(unflagged, "has values that are not numbers without a status that says so")
        or f"Every value that is not a number is flagged, in all {len(values['edge'])} extreme cases.",
        _judge_cases(dependent, "depends on the other robots of the call")
        or "No result depends on the other robots of a call.",
        f"{found['discarded']:.2%} of random robots are discarded (the paper: 0.20 %). The others reach "
        f"{found['mean_best_fitness']:.3f} m on average, standard error {found['standard_error']:.3f} m.",
    ])  # fmt: skip


def _judge_limit(points: list[dict[str, Any]]) -> str:
    """Whether damped passive robots are stable below the limit, for which it is predicted."""
    below = [p["lasted"] for p in points if p["part"] < 1 and p["damping"] > 0 and p["actuation"] == 0]
    if not below:
        return "Damped passive robots were not measured."
    lasted = float(np.mean(below))
    if lasted == 1:
        return "The predicted limit holds: every damped passive robot was stable below it."
    return f"The predicted limit does NOT hold: {1 - lasted:.1%} of damped passive robots diverged below it."


def _judge_cases(cases: list[dict[str, Any]], fault: str) -> str:
    """A sentence that names the first of the cases with a fault; empty if there is none."""
    if not cases:
        return ""
    first = cases[0]
    return (
        f"FAULT: the result of {first['body']!r} on {first['ground']!r} in {first['precision']} {fault}. "
        f"Such cases: {len(cases)}. Please report it."
    )


def border(quick: bool) -> list[dict[str, Any]]:
    """Runs on both sides of the predicted limit, with the share that stayed stable."""
    bodies = [extreme_bodies()[name] for name in ("hinge", "beam")] + big(1)
    points = []
    for stiffness, damping, actuation, precision, steps, slope in itertools.product(
        (1e3, 3e4, 1e6) if quick else (1e3, 1e4, 3e4, 1e5, 1e6, 1e7),
        (0.0, 15.0) if quick else (0.0, 5.0, 15.0, 100.0),
        (0.0, 0.1),
        get_args(Precision),
        (1000,) if quick else (1000, 4000),
        (0.0, 0.5) if quick else (0.0, 0.25, 0.5),
    ):
        scene = Scene.preset("paper").replace(
            stiffness=stiffness, damping=damping, actuation=actuation, precision=precision, steps=steps,
            large_step="run", terrain=_slope(slope),
        )  # fmt: skip
        for part in PARTS:
            limits = [stable_step(body, scene) for body in bodies]
            lasted = [
                _lasts(body, scene.replace(dt=part * s)) for body, s in zip(bodies, limits, strict=True)
            ]
            points.append(
                {
                    "stiffness": stiffness, "damping": damping, "actuation": actuation,
                    "precision": precision, "steps": steps, "slope": slope, "part": part,
                    "largest_step": float(np.mean(limits)), "lasted": float(np.mean(lasted)),
                }
            )  # fmt: skip
    return points


def _slope(slope: float) -> Terrain:
    return Terrain.from_segments(
        np.array([-1.0, 0.7]), np.array([0.0, slope]), np.array([0.1, 0.1 - 0.7 * slope])
    )


def _lasts(body: Morphology, scene: Scene) -> bool:
    rollout = simulate_one(body, initial_controllers([body], scene, 0)[0], scene)
    return rollout.status == OK and bool(
        np.abs(rollout.velocities).max() < _FASTEST * np.sqrt(scene.stiffness)
    )


def agreement(points: list[dict[str, Any]]) -> dict[str, float]:
    """Shares of stable runs below and above the predicted limit, without and with actuation."""
    found = {}
    for kind, actuation in (("passive", 0.0), ("acting", 0.1)):
        for side, below in (("below", True), ("above", False)):
            lasted = [p["lasted"] for p in points if p["actuation"] == actuation and (p["part"] < 1) == below]
            found[f"{kind} {side}"] = round(float(np.mean(lasted)), 4)
    return found


def edge() -> list[dict[str, Any]]:
    """Every extreme body on every ground: its status, whether every undefined value was flagged, and whether
    the result is the same without the other robots."""
    found = []
    for precision in get_args(Precision):
        paper = Scene.preset("paper").replace(steps=300, precision=precision, large_step="run")
        for ground, scene in extreme_grounds(paper).items():
            bodies = extreme_bodies()
            brains = initial_controllers(list(bodies.values()), scene, 0)
            together = simulate(list(bodies.values()), brains, scene)
            for (name, body), brain, rollout in zip(bodies.items(), brains, together, strict=True):
                alone = simulate_one(body, brain, scene)
                found.append(
                    {
                        "body": name, "ground": ground, "precision": precision, "status": rollout.status,
                        "flagged": _flagged(rollout), "alone": _same(rollout, alone),
                    }
                )  # fmt: skip
    return found


def _flagged(rollout: Rollout) -> bool:
    """Whether states and loss are finite wherever the status says so."""
    last = rollout.status if rollout.status != OK else len(rollout.positions) - 1
    states = (rollout.positions[: last + 1], rollout.velocities[: last + 1])
    sound = all(np.isfinite(values).all() for values in states)
    return bool(sound and np.isfinite(rollout.loss) == (rollout.status == OK))


def _same(a: Rollout, b: Rollout) -> bool:
    return a.positions.tobytes() == b.positions.tobytes() and (a.status, a.loss) == (b.status, b.loss)


def random_robots(n: int) -> dict[str, Any]:
    """Share of `n` random robots that a run would discard in 35 iterations, and the reasons."""
    scene, why = Scene.preset("paper"), {"refused": 0, "blown up": 0, "jump": 0}
    best = []
    for first in range(0, n, 500):
        bodies = big(min(500, n - first), seed=10_000 + first)
        result = learn(bodies, scene, 35, seed=first)
        finite = np.isfinite(result.losses).all(axis=1)
        sound = is_valid(result.losses, TrainingConfig.of(scene).jump_threshold)
        why["refused"] += int((result.status == REFUSED).sum())
        why["blown up"] += int((~finite & (result.status != REFUSED)).sum())
        why["jump"] += int((finite & ~sound).sum())
        best.extend((result.displacements[sound].max(axis=1)).tolist())
    return {
        "robots": n,
        "discarded": round(sum(why.values()) / n, 5),
        "why": why,
        "mean_best_fitness": round(float(np.mean(best)), 4),
        "standard_error": round(float(np.std(best) / np.sqrt(len(best))), 4),
    }


def plot(values: dict[str, Any]) -> Figure:
    """Stiffness against step, coloured by the share of stable runs, with the predicted limit; passive and
    acting."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for panel, (kind, actuation) in zip(panels, (("passive", 0.0), ("acting", 0.1)), strict=True):
        points = [p for p in values["map"] if p["actuation"] == actuation]
        by: dict[tuple[float, float, float], list[float]] = {}
        for p in points:
            by.setdefault((p["damping"], p["stiffness"], p["part"]), []).append(p["lasted"])
        borders: dict[float, list[tuple[float, float]]] = {}
        for p in points:
            borders.setdefault(p["damping"], []).append((p["largest_step"], p["stiffness"]))
        for damping, line in sorted(borders.items()):
            panel.loglog(*zip(*sorted(set(line)), strict=True), lw=1, label=f"limit at {damping:g} /s")
        steps = {(p["damping"], p["stiffness"], p["part"]): p["part"] * p["largest_step"] for p in points}
        shares = [float(np.mean(by[key])) for key in by]
        drawn = panel.scatter(
            [steps[key] for key in by], [key[1] for key in by], c=shares, cmap="RdYlGn", vmin=0, vmax=1, s=24
        )
        panel.set(title=kind, xlabel="step [s]")
    panels[0].set_ylabel("stiffness [N/m]")
    panels[0].legend(fontsize=7)
    figure.colorbar(drawn, ax=panels, label="share of stable runs")
    return figure
