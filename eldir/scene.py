"""A scene: all settings of a simulation except the robot. The engine leaves out what a scene does not
need."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field, fields, replace
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from eldir.core.arguments import require_known, require_value
from eldir.core.kernels import PRECISION, Precision
from eldir.core.records import OMITTED, Record, record
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir.terrain import Terrain

Contact = Literal["no-slip", "friction", "friction-released", "none", "coulomb"]
Sensing = Literal["centre", "centre-and-rest", "none"]
Weights = Literal["paper", "released"]
LargeStep = Literal["refuse", "subdivide", "run"]
Integrator = Literal["paper", "matched", "second-order"]

SOFTENING = 1e-4
"""Constant that is added to every spring's length [m] (docs/decisions/0001)."""
_PRESETS: dict[str, dict[str, Any]] = {
    "paper": {},
    "released-rss": {"sensing": "centre", "weights": "released"},
    "released-main": {
        "contact": "friction-released",
        "sensing": "centre",
        "weights": "released",
    },
    "built": {
        "contact": "coulomb",
        "dt": 0.05,
        "gravity": BuiltParameters.gravity,
        "damping": BuiltParameters.drag,
        "stiffness": BuiltParameters.tension,
        "precision": "f64",
        "built": BuiltParameters(),
    },
}
TRAINING_FIELDS = ("optimiser", "update_length", "jump_threshold")
"""Former fields of a scene, which older files hold; now in `eldir.training.configuration.TrainingConfig`."""
_STEPS_MEASURED_AT = 3e4  # stiffness [N/m]
_MAX_STEPS = ((3e-3, 1.6e-3), (1e-3, 8e-4), (3e-4, 3.2e-4), (1e-4, 1e-4), (4e-5, 5e-5))
"""Error [m], and the second-order scheme's step [s] at which nine robots in ten stay well below it."""
_SHARED = {"gravity": "gravity", "damping": "drag", "stiffness": "tension"}
"""Fields of a scene and of its built robot that mean the same."""


class Scheme(NamedTuple):
    """Coefficients of one integration step."""

    decay: float
    """Factor on the velocities."""
    gravity: float
    """Time for which gravity acts [s]."""
    force: float
    """Time for which the springs' forces act [s]."""


class _ForError:
    """`Scene.for_error(1e-4)` makes the paper's scene accurate, `scene.for_error(1e-4)` another one."""

    def __get__(self, scene: Scene | None, kind: type[Scene]) -> Callable[[float], Scene]:
        return (scene if scene is not None else kind())._accurate


@record
class Scene(Record):
    """Physics, terrain, controller and precision of a simulation. `docs/decisions/0001` explains how the
    presets differ. How controllers are trained is in `eldir.training.configuration.TrainingConfig`."""

    OPTIONAL = frozenset({"built", "large_step", "integrator", "window"})
    """What older files lack."""

    name: str = "paper"
    """Name of the preset from which the scene was made."""
    terrain: Terrain = field(default_factory=Terrain.flat)
    """The ground: segments side by side, each a straight line. Its lengths are metres of the scene's robot.
    For the printed robot, flat ground is the table; `eldir.built.motion.drive` is given any other."""
    contact: Contact = "no-slip"
    """Contact of a mass with the ground. "no-slip": the mass sticks. "friction": it slips by the paper's
    rule. "friction-released": the same as in the released code, which reads the ground out of bounds left of
    x = 0. "none": free flight. "coulomb": Coulomb's law, for the printed robot."""
    steps: Annotated[int, Field(ge=1, le=10**8)] = 999
    """Number of steps; a rollout has one more state."""
    dt: Annotated[float, Field(gt=0, le=1e9)] = 0.004
    """Time step [s]."""
    gravity: Annotated[float, Field(ge=-1e9, le=1e9)] = -4.8
    """Gravity, positive upwards [m/s2]."""
    damping: Annotated[float, Field(ge=0, le=1e6)] = 15.0
    """Damping: velocities decay by exp(-damping dt) in each step [1/s]."""
    stiffness: Annotated[float, Field(gt=0, le=1e38)] = 3.0e4
    """Stiffness of every spring, for masses of 1 kg [N/m]."""
    actuation: Annotated[float, Field(ge=0, lt=1)] = 0.1
    """Greatest relative change of an active spring's rest length."""
    omega: Annotated[float, Field(ge=0, le=1e4)] = 10.0
    """Angular frequency of the central pattern generators [rad/s]."""
    sensing: Sensing = "centre-and-rest"
    """Inputs of the controller beside its pattern generators: displacements from the centre of mass; or the
    same relative to their values at rest; or nothing."""
    weights: Weights = "paper"
    """Scale of the initial weights."""
    window: Annotated[int, Field(ge=1)] | None = None
    """Number of steps over which gradients are traced back. The loss is then the sum of the displacements in
    windows of this length, and the state at the start of each window counts as constant. None: all steps, as
    in the paper. The window belongs to the scene, not to `TrainingConfig`: it defines the objective whose
    gradient `loss_and_gradient` returns."""
    precision: Precision = PRECISION
    """Floating-point precision of the simulation; the printed robot requires f64."""
    integrator: Integrator = "paper"
    """"paper": as in the paper. "matched": gravity is matched to the exponential damping, which makes the
    speed of a long fall exact. "second-order": forces are matched too (docs/reference/accuracy.md)."""
    large_step: LargeStep = "refuse"
    """Treatment of a robot whose largest stable step (`eldir.engine.stable_step`) is smaller than `dt`.
    "refuse": it is not simulated, and its status says so. "subdivide": every step is divided into as many
    equal parts as are needed. "run": it is simulated all the same, and may diverge."""
    built: Annotated[BuiltParameters | None, OMITTED] = None
    """Parameters of the printed robot. It has no controller: `eldir.built.motion.drive` moves it by the free
    lengths of its motors at `steps` + 1 instants, `dt` apart. Its gravity, drag and tension are the scene's
    gravity, damping and stiffness."""

    def __post_init__(self) -> None:
        whole, flat = self.window is None or self.integrator != "second-order", self.terrain.is_flat
        expected = "None, or an integrator other than 'second-order', with whole steps"
        require_value("Scene.window", whole, expected, self.window)
        slips = flat or self.contact != "no-slip"
        require_value("Scene.contact", slips, "'friction' on ground that is not flat", repr(self.contact))
        require_value(
            "Scene.built",
            (self.built is not None) == (self.contact == "coulomb"),
            "parameters of the printed robot if and only if Scene.contact is 'coulomb'",
            f"contact {self.contact!r}",
            "start from Scene.preset('built')",
        )
        if self.built is not None:
            double = self.precision == "f64"
            require_value("Scene.precision", double, "'f64' for the printed robot", repr(self.precision))
            for ours, theirs in _SHARED.items():
                value, wanted = getattr(self, ours), getattr(self.built, theirs)
                expected = f"{wanted!r} as Scene.built.{theirs}"
                require_value(f"Scene.{ours}", value == wanted, expected, repr(value))

    @classmethod
    def preset(cls, name: str) -> Scene:
        """'paper' (the text), 'released-rss', 'released-main' (the branches of its code), 'built' (the
        printed robot on a table)."""
        require_known("scene", name, _PRESETS)
        return cls(name=name, **_PRESETS[name])

    def scheme_at(self, damping: float) -> Scheme:
        """The integrator's coefficients, with a damping [1/s]."""
        decay = float(np.exp(-damping * self.dt))
        exact = float(-np.expm1(-damping * self.dt)) / damping if damping > 0 else self.dt
        return self._scheme(decay, self.dt, exact)

    def scheme_derivative(self, damping: float) -> Scheme:
        """The derivatives of `scheme_at` with respect to the damping."""
        x = damping * self.dt
        decay = -self.dt * float(np.exp(-x))
        if x > 1:
            bend = (float(np.exp(-x)) * (1 + x) - 1) / x**2
        else:  # the same as a series, which knows no difference of nearly equal numbers
            bend, term = 0.0, -0.5
            for n in range(20):
                bend += term
                term *= -x * (n + 2) / ((n + 1) * (n + 3))
        return self._scheme(decay, 0.0, self.dt**2 * bend)

    def _scheme(self, decay: float, step: float, exact: float) -> Scheme:
        return {
            "paper": Scheme(decay, step, step),
            "matched": Scheme(decay, exact, step),
            "second-order": Scheme(decay, exact, exact),
        }[self.integrator]

    for_error = _ForError()

    def _accurate(self, error: float) -> Scene:
        """The same scene and duration with the integrator, the precision and the longest step that keep the
        error below `error` [m] after one second (`largest_step`)."""
        if self.built is not None:
            raise InputError(
                "Scene.for_error knows the learning scenes only",
                code="scene.built",
                expected="a scene such as 'paper'",
                found=repr(self.name),
                remedy="leave the step to eldir.built.motion.drive, which takes the largest stable one",
            )
        parts = int(np.ceil(self.dt / largest_step(error, self.stiffness) * (1 - 1e-12)))
        return self.replace(
            integrator="second-order", precision="f32", dt=self.dt / parts, steps=self.steps * parts
        )

    def require_controller(self) -> None:
        """Raise `InputError` for the scene of a printed robot, which has no controller."""
        if self.built is not None:
            raise InputError(
                f"the scene {self.name!r} has no controller",
                code="scene.no-controller",
                expected="a scene in which robots act, such as 'paper'",
                remedy="move a printed robot by free lengths: eldir.built.build, then eldir.built.drive",
            )

    def replace(self, **changes: Any) -> Scene:
        """The same scene with some fields changed. Rugged terrain sets the contact to "friction", and values
        that the scene shares with its built robot change in both. Raises `InputError` for a field that a
        scene does not have, and for an invalid value."""
        known = {f.name for f in fields(self)}
        for key in changes:
            if key in TRAINING_FIELDS:
                raise InputError(
                    f"unknown field {key} of a scene: it belongs to the training",
                    code="scene.training-field",
                    expected=f"eldir.training.configuration.TrainingConfig({key}=...)",
                    found=f"Scene.replace({key}=...)",
                    remedy="give it as learn(..., training=...) or as EvolutionConfig(training=...)",
                )
            require_known("field of a scene", key, sorted(known))
        terrain = changes.get("terrain")
        if isinstance(terrain, Terrain) and not terrain.is_flat and self.contact == "no-slip":
            changes.setdefault("contact", "friction")
        built = changes.get("built", self.built)
        if isinstance(built, BuiltParameters):
            built = replace(built, **{b: changes[ours] for ours, b in _SHARED.items() if ours in changes})
            changes |= {"built": built} | {ours: getattr(built, b) for ours, b in _SHARED.items()}
        return replace(self, **changes)

    @classmethod
    def upgrade(cls, values: dict[str, Any]) -> dict[str, Any]:
        """Older files hold the training in the scene; `EvolutionConfig` and `Design` take it from there."""
        return {key: value for key, value in values.items() if key not in TRAINING_FIELDS}


def largest_step(error: float, stiffness: float) -> float:
    """The longest step [s] of the second-order scheme in float32 with which nine robots in ten stay within
    `error` [m] (root mean square over masses) of the exact motion after one second, as `eldir benchmark
    accuracy` measured it. Springs stiffer than the paper's need shorter steps; `stiffness` in N/m.
    """
    steps = [step for least, step in _MAX_STEPS if least <= error]
    require_value("error", steps, f"at least {_MAX_STEPS[-1][0]:g} m", f"{error:g}")
    return steps[0] * min(1.0, float(np.sqrt(_STEPS_MEASURED_AT / stiffness)))
