"""Gradients of your own loss, a function of the rollout that is written with JAX.

    import eldir
    import jax.numpy as jnp

    def loss(rollout):
        return -jnp.mean(rollout.positions[-1, :, 0] - rollout.positions[0, :, 0])

    found = eldir.value_and_grad(loss)(bodies, controllers, scene)
    found.losses, found.controllers, found.physics

JAX differentiates the loss, the engine the simulation. Several rollouts in one loss: `eldir.jax`. Needs JAX:
pip install 'eldir[jax]'.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from eldir.controller import Controller
from eldir.core.arguments import require_value
from eldir.core.kernels import Precision
from eldir.errors import InputError, MissingDependencyError
from eldir.morphology import Morphology
from eldir.physics import Physics
from eldir.scene import Scene
from eldir.training.differentiable import RolloutArrays
from eldir.training.gradients import Motion, MotionGradient, loss_gradient

if TYPE_CHECKING:
    from eldir.engine.pack import MotionCotangents

_COMPILED = 1024  # bodies whose compiled losses are kept


Loss = Callable[..., Any]
"""A scalar from the rollout of one robot or, if it takes two arguments, from its rollout and its body."""
ValueAndGrad = Callable[..., MotionGradient]


def value_and_grad(loss: Loss) -> ValueAndGrad:
    """A function `(bodies, controllers, scene, physics=None)` that returns the value of `loss` for each
    robot, and its gradients with respect to each robot's controller and physics, as
    `eldir.training.gradients.MotionGradient`.

    `loss(rollout)` or `loss(rollout, body)` returns a scalar from the `RolloutArrays` of one robot and its
    `Morphology`. `jax.jit` compiles it, so it uses `jax.numpy` for all that depends on the rollout. It is
    compiled once for each shape of the arrays or, where it takes the body, once for each body. All robots are
    simulated together, and once.

    Raises `MissingDependencyError` without JAX, `InputError` for a loss with other arguments. The returned
    function raises `InputError` for a loss that is not a scalar, does not depend on the rollout or is not
    finite, for a scene with a window, and for one in float64 while JAX computes in float32.
    """
    import_jax()
    takes_body = _takes_body(loss)
    compiled = lru_cache(_COMPILED)(lambda case: _compile(loss, case))

    def differentiate(
        morphologies: Sequence[Morphology],
        controllers: Sequence[Controller],
        scene: Scene,
        physics: Sequence[Physics] | None = None,
    ) -> MotionGradient:
        require_precision(scene)

        def of_robot(i: int, motion: Motion) -> tuple[float, MotionCotangents]:
            case = _Case(morphologies[i], takes_body, scene.steps, scene.precision)
            return compiled(case)(motion)

        return loss_gradient(morphologies, controllers, scene, physics, of_robot)

    return differentiate


def import_jax() -> Any:
    """The module `jax`. Raises `MissingDependencyError` where it is not installed."""
    try:
        import jax
    except ModuleNotFoundError as error:
        raise MissingDependencyError(
            f"your own loss needs {error.name}, which is not installed here",
            remedy="pip install 'eldir[jax]'",
        ) from None
    return jax


def require_precision(scene: Scene) -> None:
    """Raise `InputError` for a scene in float64 while JAX computes in float32, which it would do silently."""
    enabled = scene.precision == "f32" or import_jax().config.jax_enable_x64
    require_value(
        "Scene.precision",
        enabled,
        "'f32' while JAX computes in float32",
        repr(scene.precision),
        'jax.config.update("jax_enable_x64", True) at the start, or scene.replace(precision="f32")',
    )


class _Case:
    """What a compiled loss depends on."""

    def __init__(self, body: Morphology, takes_body: bool, steps: int, precision: Precision):
        self.body, self.takes_body, self.steps, self.precision = body, takes_body, steps, precision

    @cached_property
    def _key(self) -> tuple[object, ...]:
        body, shape = self.body, (len(self.body.positions), self.body.motors, self.steps, self.precision)
        if not self.takes_body:
            return shape
        own = body.rest_lengths, body.vertices, body.lattice_springs
        return *shape, body.key, *(array.tobytes() for array in own)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Case) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)


def _takes_body(loss: Loss) -> bool:
    """Whether the loss takes a rollout and a body. Raises `InputError` where it takes neither one nor two
    arguments."""
    fits = [_accepts(loss, count) for count in (1, 2)]
    require_value("loss", any(fits), "a function of the rollout, or of the rollout and the body", loss)
    return not fits[0]


def _accepts(loss: Loss, count: int) -> bool:
    try:
        inspect.signature(loss).bind(*(None,) * count)
    except TypeError:
        return False
    return True


def _compile(loss: Loss, case: _Case) -> Callable[[Motion], tuple[float, MotionCotangents]]:
    """The compiled loss of a body, as `eldir.training.gradients.MotionLoss` without the robot's index. It
    reads only those parts of the motion that the loss uses."""
    from eldir.engine.pack import MotionCotangents

    jax, body = import_jax(), case.body
    real = np.dtype(case.precision.replace("f", "float"))
    states = (case.steps + 1, *body.positions.shape)
    shapes = RolloutArrays(
        *(jax.ShapeDtypeStruct(shape, real) for shape in (states, states, (case.steps, body.motors)))
    )

    def scalar(rollout: RolloutArrays) -> Any:
        return _require_scalar(loss(rollout, body) if case.takes_body else loss(rollout), real)

    try:
        program = jax.make_jaxpr(scalar)(shapes).jaxpr
    except (jax.errors.TracerArrayConversionError, jax.errors.ConcretizationTypeError) as error:
        raise InputError(
            "the loss needs the numbers of the rollout while JAX compiles it",
            code="loss.not-traceable",
            expected="functions of jax.numpy, and jnp.where instead of `if`",
            found=str(error).splitlines()[0],
        ) from error
    read = {id(v) for equation in program.eqns for v in equation.invars} | {id(v) for v in program.outvars}
    used = [k for k, v in zip(RolloutArrays._fields, program.invars, strict=True) if id(v) in read]
    require_value("loss", used, "a function of the rollout", "a value that does not depend on it")
    zeros = {k: np.zeros(s.shape, real) for k, s in zip(RolloutArrays._fields, shapes, strict=True)}

    def of_used(parts: dict[str, Any]) -> Any:
        return scalar(RolloutArrays(**(zeros | parts)))

    function = jax.jit(jax.value_and_grad(of_used))
    function = function.lower({k: getattr(shapes, k) for k in used}).compile()

    def differentiate(motion: Motion) -> tuple[float, MotionCotangents]:
        value, slopes = function({k: motion.read(k) for k in used})
        found = {k: np.asarray(v) for k, v in slopes.items()}
        return float(value), MotionCotangents(**({"positions": zeros["positions"]} | found))

    return differentiate


def _require_scalar(value: Any, real: np.dtype[np.floating]) -> Any:
    """The value of a loss as a number of JAX. Raises `InputError` for anything else."""
    jax = import_jax()
    number = isinstance(value, jax.Array | np.ndarray | np.generic | float | int)
    remedy = "return a number of jax.numpy"
    require_value("value of the loss", number, "a scalar", type(value).__name__, remedy)
    require_value("value of the loss", np.ndim(value) == 0, "a scalar", f"shape {np.shape(value)}", remedy)
    kind = jax.numpy.result_type(value)
    real_number = np.issubdtype(kind, np.floating)
    remedy = "indices and counts have no gradient"
    require_value("type of the loss", real_number, "a real number", kind, remedy)
    return jax.numpy.asarray(value, real)
