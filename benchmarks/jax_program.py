"""The learning scene in JAX, as a process of its own: it learns once for every line that it reads.

    python jax_program.py TASK PRECISION GRADIENTS

TASK has the arrays of `Task.save`; PRECISION is f32 or f64. The gradients of the first pass are written to
GRADIENTS. Each answer is one line of JSON: seconds by the clock and of processor time, and the losses of the
first pass [m]. One thread. Only NumPy and JAX are imported.

Of the variants that were tried, the fastest for big robots, and within a tenth of it for small ones: one
robot after the other (`lax.map`; `vmap` is as fast for small robots and half as fast for big ones), springs
by indices (matrices and gathers over each mass's springs are slower), and gradients of the weights as one
product after the time loop instead of a sum within it.
"""

import json
import os
import sys
import time

import numpy as np

os.environ["JAX_PLATFORMS"] = "cpu"
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

import jax
import jax.numpy as jnp

HIDDEN, WAVES = 32, 10
WEIGHTS = ("w1", "b1", "w2", "b2")
SENSED = 0.05  # scale of sensed positions and velocities
SOFTENING = 1e-4  # added to a spring's length [m]
RESTING = 0.025  # least speed of a landing over the time step [m/s2]


def padded(arrays: dict, real: type) -> tuple[dict, dict]:
    """Bodies and controllers, filled up to the greatest robot: springs of zero stiffness, masked masses.

    Motors come first among the springs, so that activations need no index.
    """
    n = sum(name.startswith("positions") for name in arrays)
    masses = max(len(arrays[f"start{i}"]) for i in range(n))
    motors = max(len(arrays[f"w2{i}"]) for i in range(n))
    passive = max(len(arrays[f"springs{i}"]) - len(arrays[f"w2{i}"]) for i in range(n))
    bodies, controllers = [], []
    for i in range(n):
        start, active = arrays[f"start{i}"], arrays[f"active{i}"]
        place = np.where(active, np.cumsum(active) - 1, motors + np.cumsum(~active) - 1)
        ends = np.tile([0, 1], (motors + passive, 1))
        rest, stiff = np.zeros(len(ends), real), np.zeros(len(ends), real)
        ends[place], rest[place], stiff[place] = arrays[f"springs{i}"], arrays[f"rest_lengths{i}"], 1
        x, there = np.zeros((masses, 2), real), np.zeros((masses, 1), real)
        x[: len(start)], there[: len(start)] = start, 1
        bodies.append((x, there, ends, rest, stiff))
        w1, w2 = np.zeros((HIDDEN, WAVES + 4 * masses), real), np.zeros((motors, HIDDEN), real)
        b2 = np.zeros(motors, real)
        given = {name: arrays[f"{name}{i}"] for name in WEIGHTS}
        w1[:, : given["w1"].shape[1]], w2[: len(given["w2"])] = given["w1"], given["w2"]
        b2[: len(given["b2"])] = given["b2"]
        controllers.append((w1, given["b1"].astype(real), w2, b2))
    body, weights = (
        [jnp.asarray(np.stack(each)) for each in zip(*records, strict=True)]
        for records in (bodies, controllers)
    )
    return dict(zip(("x", "there", "ends", "rest", "stiff"), body, strict=True)), dict(
        zip(WEIGHTS, weights, strict=True)
    )


def functions(arrays: dict, real: type, motors: int) -> tuple:
    """`update(weights, body)`, which learns once, and `loss(weights, body)`, of one robot."""
    steps, dt = int(arrays["steps"]), float(arrays["dt"])
    decay = real(np.exp(-float(arrays["damping"]) * dt))
    fall = np.array([0, dt * float(arrays["gravity"])], real)
    impulse, actuation = real(dt * float(arrays["stiffness"])), real(arrays["actuation"])
    ground, length = real(arrays["ground"]), real(arrays["update_length"])
    phases = float(arrays["omega"]) * np.arange(steps)[:, None] * dt
    waves = np.sin(phases + 2 * np.pi * np.arange(WAVES) / WAVES).astype(real)
    nothing = jnp.zeros((steps, HIDDEN), real), jnp.zeros((steps, motors), real)

    def rollout(before: tuple, weights: dict, body: dict) -> tuple:
        """The loss, and what both layers got; `before` is added to what goes into their activations."""
        there, ends, stiff = body["there"], body["ends"], impulse * body["stiff"]
        mean = 1 / there.sum()
        at_rest = body["x"] - there * body["x"].sum(0) * mean

        def step(state: tuple, given: tuple) -> tuple:
            (x, v), (wave, extra, more) = state, given
            moved = there * (x - x.sum(0) * mean) - at_rest
            inputs = jnp.concatenate([wave, SENSED * jnp.concatenate([moved, v], axis=1).ravel()])
            hidden = jnp.tanh(weights["w1"] @ inputs + weights["b1"] + extra)
            output = jnp.tanh(weights["w2"] @ hidden + weights["b2"] + more)
            along = x[ends[:, 0]] - x[ends[:, 1]]
            size = jnp.sqrt((along * along).sum(1)) + SOFTENING
            wanted = body["rest"].at[:motors].multiply(1 + actuation * output)
            pull = (stiff * (1 - wanted / size))[:, None] * along
            pulled = jnp.zeros_like(x).at[ends[:, 0]].add(pull).at[ends[:, 1]].add(-pull)
            v = there * (decay * v - pulled + fall)
            lands = (x[:, 1] + dt * v[:, 1] < ground) & (v[:, 1] < -RESTING * dt)
            until = jnp.where(lands, (ground - x[:, 1]) / jnp.where(lands, v[:, 1], 1), dt)
            return (x + until[:, None] * v, jnp.where(lands[:, None], 0, v)), (inputs, hidden)

        start = body["x"], jnp.zeros_like(body["x"])
        (x, _), kept = jax.lax.scan(step, start, (jnp.asarray(waves), *before))
        return (body["x"] - x)[:, 0].sum() * mean, kept

    def gradient(weights: dict, body: dict) -> tuple:
        found = jax.value_and_grad(rollout, has_aux=True)(nothing, weights, body)
        (loss, (inputs, hidden)), (first, second) = found
        slopes = first.T @ inputs, first.sum(0), second.T @ hidden, second.sum(0)
        return loss, dict(zip(WEIGHTS, slopes, strict=True))

    def update(learner: tuple, body: dict) -> tuple:
        """One update; the best weights are kept, as the engine keeps them."""
        weights, best, least = learner
        loss, slopes = gradient(weights, body)
        by = length / (jnp.sqrt(sum((s * s).sum() for s in slopes.values())) + real(1e-6))
        best = jax.tree.map(lambda new, old: jnp.where(loss < least, new, old), weights, best)
        after = jax.tree.map(lambda w, s: w - by * s, weights, slopes)
        return (after, best, jnp.minimum(loss, least)), loss

    def loss(weights: dict, body: dict) -> jax.Array:
        return rollout(nothing, weights, body)[0]

    return gradient, update, loss


def main() -> None:
    """Compile, write the gradients, then answer."""
    task, precision, gradients = sys.argv[1:]
    jax.config.update("jax_enable_x64", precision == "f64")
    real = {"f32": np.float32, "f64": np.float64}[precision]
    arrays = dict(np.load(task))
    bodies, controllers = padded(arrays, real)
    gradient, update, loss = (
        jax.jit(lambda first, second, f=f: jax.lax.map(lambda both: f(*both), (first, second)))
        for f in functions(arrays, real, controllers["w2"].shape[1])
    )
    n = len(bodies["x"])
    found = {name: np.asarray(g, np.float64) for name, g in gradient(controllers, bodies)[1].items()}
    shapes = {f"{name}{i}": arrays[f"{name}{i}"].shape for name in WEIGHTS for i in range(n)}
    np.savez(
        gradients,
        **{  # without what fills up
            f"{name}{i}": g[i][tuple(map(slice, shapes[f"{name}{i}"]))]
            for name, g in found.items()
            for i in range(n)
        },
    )
    for _ in sys.stdin:
        learner = controllers, controllers, jnp.full(n, np.inf, real)
        began, spent, losses = time.perf_counter(), time.process_time(), []
        for _ in range(int(arrays["iterations"])):
            learner, now = update(learner, bodies)
            losses.append(now)
        losses.append(loss(learner[0], bodies))
        first = np.asarray(jax.block_until_ready(losses)[0])
        took = [time.perf_counter() - began, time.process_time() - spent]
        print(json.dumps([*took, first.tolist()]), flush=True)


if __name__ == "__main__":
    main()
