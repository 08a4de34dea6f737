"""`eldir benchmark skips`: the gain of each shortcut, and a check that it does not change the result.

The reference is the same engine with that shortcut switched off, or with unneeded results requested. Where
the shortcut only saves additions of zeros, every bit of the result is the same. Code that is compiled for
another kind of ground, or sums with another length, may round differently.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from eldir.benchmark.measurement import big, limit_threads, ratio, time_in_turns
from eldir.benchmark.tables import text_table
from eldir.controller import Controller
from eldir.core.records import FloatArray, IntArray
from eldir.engine.batch import BatchConfig, BatchResult, prepare, run_batch
from eldir.engine.shortcuts import ALL, Shortcuts
from eldir.learning import learn
from eldir.morphology import Morphology
from eldir.scene import Scene
from eldir.terrain import Terrain
from eldir.training.configuration import TrainingConfig
from eldir.training.loop import initial_controllers

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Bodies = list[Morphology]
Task = Callable[[], BatchResult]
_COPIES = 4
_ROUNDING = 1e-4
"""Smaller differences, of losses [m] and relative ones of gradients, are sums rounded in another order."""
_STIFF = 1.0e6  # every robot diverges at once [N/m]


class VariantPair(NamedTuple):
    """The same robots simulated in two ways."""

    short: Task
    long: Task


def _task(
    bodies: Bodies, scene: Scene, brains: list[Controller] | None = None, backward: bool = True,
    shortcuts: Shortcuts = ALL,
) -> Task:  # fmt: skip
    chosen = brains if brains is not None else initial_controllers(bodies, scene, 0)
    return prepare(bodies, chosen, scene, config=BatchConfig(backward=backward, shortcuts=shortcuts))


def no_controller(bodies: Bodies, scene: Scene) -> VariantPair:
    passive = [with_motors(body, False) for body in bodies]
    return VariantPair(_task(passive, scene), _task(passive, scene, shortcuts=Shortcuts(no_controller=False)))


def no_sensing(bodies: Bodies, scene: Scene) -> VariantPair:
    deaf = scene.replace(sensing="none")
    return VariantPair(_task(bodies, deaf), _task(bodies, deaf, shortcuts=Shortcuts(no_sensing=False)))


def no_gradient(bodies: Bodies, scene: Scene) -> VariantPair:
    return VariantPair(_task(bodies, scene, backward=False), _task(bodies, scene))


def no_history(bodies: Bodies, scene: Scene) -> VariantPair:
    long = _task(bodies, scene, backward=False, shortcuts=Shortcuts(no_history=False))
    return VariantPair(_task(bodies, scene, backward=False), long)


def no_search_on_level_ground(bodies: Bodies, scene: Scene) -> VariantPair:
    cut = Terrain.from_segments(np.linspace(-1, 1.25, 33), np.zeros(33), np.full(33, 0.1))
    slippery = scene.replace(contact="friction")
    long = slippery.replace(terrain=cut)
    return VariantPair(_task(bodies, slippery), _task(bodies, long, shortcuts=Shortcuts(grid=False)))


def grid_on_rugged_ground(bodies: Bodies, scene: Scene) -> VariantPair:
    rugged = scene.replace(terrain=Terrain.rugged(np.random.default_rng(1)))
    return VariantPair(_task(bodies, rugged), _task(bodies, rugged, shortcuts=Shortcuts(grid=False)))


def no_contact(bodies: Bodies, scene: Scene) -> VariantPair:
    free = scene.replace(contact="none")
    return VariantPair(_task(bodies, free), _task(bodies, free, shortcuts=Shortcuts(no_contact=False)))


def no_outputs_for_passive_springs(bodies: Bodies, scene: Scene) -> VariantPair:
    brains = initial_controllers(bodies, scene, 0)
    wide = [_with_silent_outputs(body, brain) for body, brain in zip(bodies, brains, strict=True)]
    return VariantPair(
        _task(bodies, scene, brains), _task([with_motors(b, True) for b in bodies], scene, wide)
    )


def stop(bodies: Bodies, scene: Scene) -> VariantPair:
    stiff = scene.replace(stiffness=_STIFF, large_step="run")
    return VariantPair(_task(bodies, stiff), _task(bodies, stiff, shortcuts=Shortcuts(stop=False)))


CASES: dict[str, Callable[[Bodies, Scene], VariantPair]] = {
    "no controller for passive bodies": no_controller,
    "no sensing in an open loop": no_sensing,
    "no adjoint without a gradient": no_gradient,
    "no history without a gradient": no_history,
    "no search on level ground": no_search_on_level_ground,
    "remembered ground, a bound and a grid": grid_on_rugged_ground,
    "no contact in free flight": no_contact,
    "no outputs for passive springs": no_outputs_for_passive_springs,
    "no step after a robot has diverged": stop,
}


def difference(variants: VariantPair) -> dict[str, float]:
    """Greatest differences of the losses [m], and of the gradients of W1 and b1 relative to their length."""
    short, long = variants.short(), variants.long()
    found = {"loss": _greatest(short.losses, long.losses), "status": _greatest(short.status, long.status)}
    if all(len(variant.best) == len(variant.batch.weights) for variant in (short, long)):
        pairs = zip(short.batch.controllers(short.best), long.batch.controllers(long.best), strict=True)
        apart = [
            (_greatest(a.w1, b.w1) + _greatest(a.b1, b.b1)) / (np.linalg.norm(a.w1) or 1.0) for a, b in pairs
        ]
        found["gradient"] = float(max(apart))
    return found


def measure(quick: bool, say: Callable[[str], None]) -> dict[str, Any]:
    """Gain and difference of every shortcut on one thread."""
    bodies, turns = big(6 if quick else 24), 5 if quick else 15
    values: dict[str, Any] = {"turns": turns, "robots": len(bodies), "skips": {}}
    for number, (name, case) in enumerate(CASES.items(), 1):
        say(f"{number} of {len(CASES) + 1}: {name}")
        with limit_threads(1):
            variants = case(bodies, Scene())
            seconds = time_in_turns(variants._asdict(), turns, time.process_time)
            apart = difference(case(bodies, Scene()))
        values["skips"][name] = {"gain": round(ratio(seconds, "long", "short"), 3), "difference": apart}
    say(f"{len(CASES) + 1} of {len(CASES) + 1}: {_ONCE}")
    values["skips"][_ONCE] = _repeated(bodies, turns)
    return values


_ONCE = "no second simulation of a design"
_UNITS = {"loss": " m", "status": "", "gradient": " of its length"}


def describe(values: dict[str, Any]) -> str:
    """A table, whether results are the same, and what gains nothing here."""
    found = values["skips"]
    rows = []
    for name, row in found.items():
        differs = [f"{what} {by:.0e}{_UNITS[what]}" for what, by in row["difference"].items() if by]
        rows.append([name, f"{row['gain']:.2f}", ", ".join(differs) or "none"])
    table = text_table(["what is skipped", "times as fast", "greatest difference"], rows)
    wrong = [name for name, row in found.items() if _is_wrong(row["difference"])]
    useless = [name for name, row in found.items() if row["gain"] < 1]
    verdict = [
        f"FAULT: results differ by more than rounding with: {', '.join(wrong)}. Please report it."
        if wrong
        else "Results are the same with every shortcut, to the rounding of sums."
    ]
    if useless:
        verdict.append(f"No gain on this machine: {', '.join(useless)}.")
    return "\n".join([table, "", *verdict])


def _is_wrong(differences: dict[str, float]) -> bool:
    return bool(differences.get("status")) or not all(by <= _ROUNDING for by in differences.values())


def _repeated(bodies: Bodies, turns: int) -> dict[str, Any]:
    """Learning with several copies of every robot."""
    scene, copies = Scene(), bodies * _COPIES
    brains = initial_controllers(bodies, scene, 0) * _COPIES

    def short() -> FloatArray:
        return learn(copies, scene, 1, controllers=brains).losses

    def long() -> FloatArray:
        return run_batch(
            copies,
            brains,
            scene,
            config=BatchConfig(iterations=1, backward=True, update_length=TrainingConfig().update_length),
        ).losses

    with limit_threads(1):
        seconds = time_in_turns({"short": short, "long": long}, turns, time.process_time)
        apart = {"loss": _greatest(short(), long())}
    return {"gain": round(ratio(seconds, "long", "short"), 3), "difference": apart}


def with_motors(body: Morphology, active: bool) -> Morphology:
    """The body with all its springs active, or all passive."""
    return Morphology(
        body.positions, body.springs, body.rest_lengths, np.full(len(body.springs), active),
        body.vertices, body.lattice_springs,
    )  # fmt: skip


def _with_silent_outputs(body: Morphology, brain: Controller) -> Controller:
    """A controller with an output for every spring, those of passive ones 0."""
    w2, b2 = np.zeros((len(body.springs), brain.w2.shape[1])), np.zeros(len(body.springs))
    w2[body.active], b2[body.active] = brain.w2, brain.b2
    return Controller(brain.w1, brain.b1, w2, b2)


def _greatest(a: FloatArray | IntArray, b: FloatArray | IntArray) -> float:
    """Greatest difference; equal infinities count as equal."""
    with np.errstate(invalid="ignore"):
        return float(np.where(a == b, 0.0, np.abs(a.astype(float) - b)).max())


def plot(values: dict[str, Any]) -> Figure:
    """Plot of the gain of every shortcut, and of the difference of the results."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4), layout="constrained")
    axes = figure.subplots()
    names = list(values["skips"])
    gains = [values["skips"][name]["gain"] for name in names]
    axes.barh(names, gains, color="#1f9d3a")
    for row, name in enumerate(names):
        apart = max(values["skips"][name]["difference"].values())
        agreement = "every bit the same" if apart == 0 else f"same to {apart:.0e}"
        axes.annotate(
            f"{gains[row]:.2f}, {agreement}",
            (gains[row], row),
            (4, 0),
            textcoords="offset points",
            va="center",
        )
    axes.invert_yaxis()
    axes.axvline(1, color="grey", lw=0.8)
    axes.set(
        xscale="log",
        xlim=(0.8, 4 * max(gains)),
        xlabel="time without the shortcut, relative to the time with it",
    )
    return figure
