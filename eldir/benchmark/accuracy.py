"""`eldir benchmark accuracy`: run time against error, for each integrator, step and precision.

The error is the root mean square, over a robot's masses, of the distance from a converged reference after one
second: the second-order scheme in float64 with steps of 10 us. The error of a gradient is relative to the
length of the reference gradient. Times are processor times of one thread.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

import numpy as np

from eldir.benchmark.measurement import limit_threads, small, without_motors
from eldir.benchmark.tables import text_table
from eldir.controller import Controller
from eldir.core.kernels import Precision
from eldir.core.records import FloatArray
from eldir.engine.batch import prepare
from eldir.engine.validity import OK
from eldir.morphology import Morphology
from eldir.rollout import loss_and_gradient, simulate_one
from eldir.scene import Integrator, Scene
from eldir.terrain import Terrain
from eldir.training.loop import initial_controllers

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Say = Callable[[str], None]
SECONDS = 1.0
STEPS = (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4, 1.25e-4)
_REFERENCE = {"integrator": "second-order", "precision": "f64", "dt": 1e-5}
_SEED = 1
_HIGH = 5.0  # where nothing meets the ground within a second [m]
_WANTED = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5)
_PAPER = "paper 4 ms f32"


class Setting(NamedTuple):
    """One combination of integrator, step and precision."""

    integrator: Integrator
    dt: float
    """Time step [s]."""
    precision: Precision

    def apply_to(self, scene: Scene) -> Scene:
        """The scene for one second with this setting, also where the step is unstable."""
        return scene.replace(**self._asdict(), steps=round(SECONDS / self.dt), large_step="run")


class Case(NamedTuple):
    """Robots in a scene."""

    scene: Scene
    bodies: list[Morphology]
    brains: list[Controller]


def cases(n: int) -> dict[str, Case]:
    """The scenes of the diagrams, with `n` robots each."""
    bodies, paper = small(n, _SEED), Scene.preset("paper")
    high = [replace(body, positions=body.positions + np.array([0, _HIGH])) for body in bodies]
    passive = [without_motors(body) for body in bodies]
    dropped = [replace(body, positions=body.positions + np.array([0, 0.02])) for body in passive]
    rugged = paper.replace(terrain=Terrain.rugged(np.random.default_rng(1)))
    found = {
        "acting in free fall": (paper, high),
        "passive drop": (paper, dropped),
        "acting on ground, 3e3 N/m": (paper.replace(stiffness=3e3), bodies),
        "acting on ground, 3e4 N/m": (paper, bodies),
        "rugged ground": (rugged, bodies),
    }
    return {
        name: Case(scene, robots, initial_controllers(robots, scene, _SEED))
        for name, (scene, robots) in found.items()
    }


def measure(quick: bool, say: Say) -> dict[str, Any]:
    """Measure all diagrams; `say` is called with a line before each scene."""
    robots, gradients = (5, 2) if quick else (16, 8)
    values: dict[str, Any] = {"robots": robots, "seconds": SECONDS, "scenes": {}}
    with limit_threads(1):
        all_cases = cases(robots)
        for number, (name, case) in enumerate(all_cases.items(), 1):
            say(f"{number} of {len(all_cases)}: {name}")
            points = diagram(case)
            if case.bodies[0].motors and name != "acting in free fall":
                _add_gradients(Case(case.scene, case.bodies[:gradients], case.brains[:gradients]), points)
            front = pareto(points)
            values["scenes"][name] = {"points": points, "pareto": front, "cheapest": cheapest(points)}
    return values


def describe(values: dict[str, Any]) -> str:
    """For each scene, the fastest setting below each error; and what the paper's own setting reaches."""
    lines = [
        f"Fastest setting for which nine of ten robots are nearer to the truth than the error after "
        f"{values['seconds']:g} s ({values['robots']} robots)."
    ]
    for name, scene in values["scenes"].items():
        by_name = {point["name"]: point for point in scene["points"]}
        rows = [
            [f"{float(error):g}", f"{by_name[best]['ms_per_robot']:.2f}", best]
            if best
            else [error, "", "none"]
            for error, best in scene["cheapest"].items()
        ]
        lines += ["", name, text_table(["error [m]", "ms a robot", "integrator, step, precision"], rows)]
        paper = by_name.get(_PAPER)
        if paper is not None:
            lines.append(_judge(paper, scene))
    return "\n".join(lines)


def _judge(paper: dict[str, Any], scene: dict[str, Any]) -> str:
    """What the paper's setting reaches, in words."""
    met = [error for error in sorted(map(float, scene["cheapest"])) if paper["error_90"] < error]
    reached = f"meets {met[0]:g} m" if met else f"does not meet {max(map(float, scene['cheapest'])):g} m"
    return f"The paper's setting, {_PAPER}, {reached} in {paper['ms_per_robot']:.2f} ms a robot."


def settings() -> list[Setting]:
    """Every integrator with every step and precision."""
    return [
        Setting(integrator, dt, precision)
        for integrator in get_args(Integrator)
        for precision in get_args(Precision)
        for dt in STEPS
    ]


def diagram(case: Case) -> list[dict[str, Any]]:
    """A point for every setting: time and error, median and 90th percentile over the robots."""
    reference = ends(case, reference_scene(case.scene))
    points = []
    for setting in settings():
        scene = setting.apply_to(case.scene)
        errors = distances(ends(case, scene), reference)
        points.append(
            {
                "name": f"{setting.integrator} {setting.dt * 1e3:g} ms {setting.precision}",
                **setting._asdict(),
                "ms_per_robot": round(_seconds(case, scene) / len(case.bodies) * 1e3, 4),
                "error": float(np.median(errors)),
                "error_90": float(np.quantile(errors, 0.9)),
            }
        )
    return points


def reference_scene(scene: Scene) -> Scene:
    """The scene of the converged reference."""
    return Setting(**_REFERENCE).apply_to(scene)  # type: ignore[arg-type]


def ends(case: Case, scene: Scene) -> list[FloatArray]:
    """Positions after the last step, (M, 2) for each robot; infinite where it diverged."""
    found = []
    for body, brain in zip(case.bodies, case.brains, strict=True):
        rollout = simulate_one(body, brain, scene)
        found.append(rollout.positions[-1] if rollout.status == OK else np.full(body.positions.shape, np.inf))
    return found


def distances(found: Sequence[FloatArray], reference: Sequence[FloatArray]) -> FloatArray:
    """Root mean square distances over masses [m], shape (n,)."""
    pairs = zip(found, reference, strict=True)
    return np.array([np.sqrt(((a - b) ** 2).sum(axis=1).mean()) for a, b in pairs])


def _seconds(case: Case, scene: Scene) -> float:
    """Processor time of the shortest of three runs [s]."""
    variant = prepare(case.bodies, case.brains, scene)
    taken = []
    for _ in range(3):
        began = time.process_time()
        variant()
        taken.append(time.process_time() - began)
    return min(taken)


def _add_gradients(case: Case, points: list[dict[str, Any]]) -> None:
    """The relative error of each setting's gradient, of the loss after one second."""
    reference = gradient_vectors(case, reference_scene(case.scene))
    for point in points:
        setting = Setting(point["integrator"], point["dt"], point["precision"])
        found = gradient_vectors(case, setting.apply_to(case.scene))
        errors = [np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in zip(found, reference, strict=True)]
        point["gradient_error"] = float(np.median(errors))


def gradient_vectors(case: Case, scene: Scene) -> list[FloatArray]:
    """Each robot's gradient with respect to its weights, as one vector."""
    found = []
    for body, brain in zip(case.bodies, case.brains, strict=True):
        _, (gradient,) = loss_and_gradient([body], [brain], scene)
        found.append(np.concatenate([getattr(gradient, k).ravel() for k in ("w1", "b1", "w2", "b2")]))
    return found


def pareto(points: Sequence[dict[str, Any]]) -> list[int]:
    """Indices of the Pareto front in time and error, fastest first."""
    front: list[int] = []
    for i in sorted(range(len(points)), key=lambda i: points[i]["ms_per_robot"]):
        if not front or points[i]["error_90"] < points[front[-1]]["error_90"]:
            front.append(i)
    return front


def cheapest(points: Sequence[dict[str, Any]]) -> dict[str, str | None]:
    """For several errors, the fastest setting that stays below them for nine robots in ten."""
    front = [points[i] for i in pareto(points)]
    return {
        f"{error:g}": next((p["name"] for p in front if p["error_90"] < error), None) for error in _WANTED
    }


def plot(values: dict[str, Any]) -> Figure:
    """Time against error, a panel for each scene, and against the gradient's below where it was measured.

    The error is the 90th percentile over the robots, by which the front is chosen too; the gradient's is the
    median.
    """
    from matplotlib.figure import Figure

    scenes = values["scenes"]
    figure = Figure(figsize=(3.2 * len(scenes), 6.4), layout="constrained")
    panels = figure.subplots(2, len(scenes), sharex=True, sharey="row", squeeze=False)
    colours = dict(zip(get_args(Integrator), ("#666666", "#0072B2", "#D55E00"), strict=True))
    for column, (name, scene) in zip(panels.T, scenes.items(), strict=True):
        for integrator, colour in colours.items():
            for precision, style in (("f32", "o--"), ("f64", "s-")):
                line = [
                    p for p in scene["points"] if (p["integrator"], p["precision"]) == (integrator, precision)
                ]
                times, label = [p["ms_per_robot"] for p in line], f"{integrator} {precision}"
                errors = [p["error_90"] for p in line]
                column[0].loglog(times, errors, style, color=colour, ms=4, label=label)
                if "gradient_error" in line[0]:
                    column[1].loglog(times, [p["gradient_error"] for p in line], style, color=colour, ms=4)
        front = [scene["points"][i] for i in scene["pareto"]]
        column[0].loglog(
            [p["ms_per_robot"] for p in front], [p["error_90"] for p in front],
            color="gold", lw=6, alpha=0.4, label="Pareto front",
        )  # fmt: skip
        column[0].set_title(name, fontsize=9)
        below = column[1] if column[1].lines else column[0]
        below.set_xlabel("time [ms]")
        below.tick_params(labelbottom=True)
    figure.supxlabel("time: the processor's for one robot and one simulated second", fontsize=10)
    panels[0, 0].set_ylabel("error after 1 s [m], 90th percentile")
    measured = [panel for panel in panels[1] if panel.lines]
    for panel in panels[1]:
        if panel not in measured:
            panel.remove()
    if measured:
        measured[0].set_ylabel("relative error of the gradient, median")
        measured[0].tick_params(labelleft=True)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, loc="outside upper center", ncols=len(labels))
    return figure
