"""Two-way shape-memory springs heated by a current: heat balance, hysteresis, free length.

    m c dT/dt = I^2 R(xi) - h A (T - T_ambient) + m L dxi/dt

with xi the martensite fraction, which falls while heating (L > 0 is then absorbed). The kinetics are
Liang and Rogers' cosines. Written for a change from T to T' they need no memory of the point where the
temperature reversed, and minor loops start from the fraction at that point:

    heating   xi' = xi gA(T')/gA(T)                      gA = [cos(pi (T - As)/(Af - As)) + 1]/2
    cooling   1 - xi' = (1 - xi) (1 - gM(T'))/(1 - gM(T))   gM = [cos(pi (T - Mf)/(Ms - Mf)) + 1]/2
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from math import cos, exp, pi
from typing import Any, NamedTuple

import numpy as np

from eldir.core.records import BoolArray, FloatArray, Record
from eldir.errors import InputError
from eldir.parameters.springs import SpringParameters

_SECANTS = 4  # rounds for the heat capacity over a step; a fifth changes T by less than 1e-3 K
_LARGEST_CHANGE = 2.0  # [K]
_GRID, _LONGEST = 0.01, 16.0  # of the logarithm of cooling: 0.7 K at most; after e^-16 it is as the air
_COLD = 1e-9  # above the air: no spring that cools is colder [K]
_FEW = 48  # fewer springs are followed one by one, in plain numbers: that takes less time, and finds the same


@dataclass(frozen=True, eq=False)
class SpringState(Record):
    """Temperature and phase of A springs."""

    temperature: FloatArray
    """Temperatures [C], shape (A,)."""
    martensite: FloatArray
    """Martensite fractions xi, shape (A,)."""

    def __post_init__(self) -> None:
        self._set_array("temperature", np.float64, (None,))
        self._set_array("martensite", np.float64, (len(self.temperature),))

    @classmethod
    def cold(cls, count: int, parameters: SpringParameters | None = None) -> SpringState:
        """`count` springs at ambient temperature, all martensite."""
        ambient = (parameters or SpringParameters()).ambient
        return cls(np.full(count, ambient), np.ones(count))


@dataclass(frozen=True, eq=False)
class SpringHistory(Record):
    """A springs at the end of each of T time steps."""

    temperature: FloatArray
    """Temperatures [C], shape (T, A)."""
    martensite: FloatArray
    """Martensite fractions xi, shape (T, A)."""
    length: FloatArray
    """Free lengths between centres [m], shape (T, A)."""
    current: FloatArray
    """Mean currents over each step [A], shape (T, A)."""

    @property
    def final(self) -> SpringState:
        """State at the end, from which a further run can continue."""
        return SpringState(self.temperature[-1], self.martensite[-1])


class _Operations(NamedTuple):
    """What `_integrate` does with the numbers of one spring, or with arrays of many: the same bits."""

    least: Callable[..., Any]
    any: Callable[..., Any]
    where: Callable[..., Any]
    """where(condition, a, b)"""
    ratio: Callable[..., Any]
    """a / b, and 0 where b is 0."""
    exp: Callable[..., Any]
    """exp(x) where a condition holds, elsewhere another value."""
    cos: Callable[..., Any]
    """The cosine of an angle, clipped to 0 and pi."""


_ONE = _Operations(
    min,
    bool,
    lambda condition, a, b: a if condition else b,
    lambda a, b: a / b if b else 0.0,
    lambda x, where, other: exp(x) if where else other,
    lambda angle: 1.0 if angle <= 0.0 else -1.0 if angle >= pi else cos(angle),
)


def _many() -> _Operations:
    exp_, cos_ = _of_arrays(exp), _of_arrays(cos)
    return _Operations(
        np.minimum,
        np.any,
        np.where,
        lambda a, b: np.divide(a, b, out=np.zeros_like(a), where=b != 0),
        lambda x, where, other: exp_(x, out=other.copy(), where=where),
        lambda angle: cos_(np.minimum(np.maximum(angle, 0.0), pi)),
    )


@cache
def _of_arrays(function: Callable[[float], float]) -> Callable[..., Any]:
    """A function of `math` for arrays. NumPy's is faster, but rounds in another way on some processors."""
    numpys: Callable[..., Any] = getattr(np, function.__name__)
    probe = np.linspace(-4.0, 4.0, 4001)
    if np.array_equal(numpys(probe), list(map(function, probe.tolist()))):
        return numpys
    slow = np.frompyfunc(function, 1, 1)

    def one_by_one(x: FloatArray, out: FloatArray | None = None, where: Any = True) -> Any:
        return slow(x, out=np.empty_like(x) if out is None else out, where=where, casting="unsafe")

    return one_by_one


def _integrate(spring: Any, on: Any, dt: float, parts: int, of: _Operations) -> FloatArray:
    """Temperatures, fractions and currents after every `parts` steps of `dt` [s], shape (3, T) or (3, T, A).

    `of`: the operations for one spring or for many; `spring` and `on` have numbers or arrays of shape (A,).
    """
    least, any_, where, ratio, exp_, cos_ = of
    ambient, loss, sensible, latent, r_hot, r_change, lead, voltage, most = spring[:9]
    melting, freezing, (temperature, xi) = spring[9:12], spring[12:15], spring[15:]
    free = exp_(-loss * dt / sensible, sensible > 0.0, sensible)
    found = []
    for closed in on:
        charge = 0.0
        for _ in range(parts):
            resistance = r_hot + r_change * xi
            current = least(most, voltage / (resistance + lead))
            target = ambient + closed * (current * current) * resistance / loss
            heating = target > temperature
            rest = where(heating, xi, 1.0 - xi)  # what can still transform
            after, xi_after, decay = target + (temperature - target) * free, xi, free
            if any_(rest):
                zero, scale, sign = where(heating, melting, freezing)
                before = 1.0 + sign * cos_((temperature - zero) * scale)
                for _ in range(_SECANTS):
                    after = target + (temperature - target) * decay
                    left = rest * least(ratio(1.0 + sign * cos_((after - zero) * scale), before), 1.0)
                    xi_after = where(heating, left, 1.0 - left)
                    changed = (xi_after != xi) & (after != temperature)
                    if not any_(changed):
                        break
                    secant = ratio(xi_after - xi, after - temperature)
                    decay = exp_(-loss * dt / (sensible - latent * secant), changed, decay)
            temperature, xi = after, xi_after
            charge += closed * current / parts
        found.append((temperature, xi, charge))
    return np.array(found).swapaxes(0, 1)


class HeatModel:
    """Heat balance of A springs, each with its own parameters, integrated from state to state."""

    def __init__(self, parameters: Sequence[SpringParameters], largest_change: float = _LARGEST_CHANGE):
        """`largest_change`: steps are divided so that no temperature changes by more in one part [K]."""
        self._largest_change = largest_change

        def gather(name: str) -> FloatArray:
            return np.array([getattr(p, name) for p in parameters], dtype=np.float64)

        self._ambient, self._loss = gather("ambient"), gather("loss")
        self._sensible = gather("mass") * gather("heat_capacity")
        self._latent = gather("mass") * gather("latent_heat")
        r_hot = np.array([p.resistance_at(0.0) for p in parameters])
        r_change = np.array([p.resistance_at(1.0) for p in parameters]) - r_hot
        voltage, most = gather("supply_voltage"), gather("current_limit")
        self._cold, self._hot = gather("cold_length"), gather("hot_length")
        a_start, self._m_finish = gather("austenite_start"), gather("martensite_finish")
        melting = pi / (gather("austenite_finish") - a_start)
        self._freezing = pi / (gather("martensite_start") - self._m_finish)
        sign = np.ones(len(parameters))
        self._numbers = np.array(
            [
                *(self._ambient, self._loss, self._sensible, self._latent),
                *(r_hot, r_change, gather("lead_resistance"), voltage, most),
                *(a_start, melting, sign, self._m_finish, self._freezing, -sign),
            ]
        )
        least, greatest = (f(r_hot, r_hot + r_change) for f in (np.minimum, np.maximum))
        self._strongest = np.minimum(most, voltage / least) ** 2 * greatest

    def run(self, on: BoolArray | FloatArray, dt: float, state: SpringState | None = None) -> SpringHistory:
        """Temperatures, fractions and lengths while contacts switch; see `heat`."""
        on = np.asarray(on, dtype=np.float64)
        if state is None:
            state = SpringState(self._ambient, np.ones(len(self._ambient)))
        heated = on.max(axis=0, initial=0.0) * self._strongest
        strongest = np.maximum(heated, self._loss * np.abs(state.temperature - self._ambient))
        parts = np.maximum(np.ceil(strongest / self._sensible * dt / self._largest_change), 1).astype(int)
        springs = np.concatenate([self._numbers, [state.temperature, state.martensite]])
        found = np.empty((3, *on.shape))
        if len(parts) < _FEW:
            known: dict[bytes, FloatArray] = {}  # springs that are alike and heated alike
            for a, (spring, closed) in enumerate(zip(springs.T, on.T, strict=True)):
                key = spring.tobytes() + closed.tobytes()
                if key not in known:
                    n = int(parts[a])
                    known[key] = _integrate(spring.tolist(), closed.tolist(), dt / n, n, _ONE)
                found[:, :, a] = known[key]
        else:
            for n in np.unique(parts).tolist():
                some = parts == n
                found[:, :, some] = _integrate(springs[:, some], on[:, some], dt / n, n, _many())
        temperatures, fractions, currents = found
        lengths = self._cold + (self._hot - self._cold) * (1.0 - fractions)
        return SpringHistory(temperatures, fractions, lengths, currents)

    def cool(self, state: SpringState, seconds: float) -> SpringState:
        """The springs after `seconds` in which nothing heats them, however long.

        A spring that is colder than the air counts as one of the air's temperature.
        """
        s, time = self._cooling(state, float((self._loss / self._sensible).max()) * seconds)
        reached = np.array([np.interp(seconds, column, s) for column in time.T])
        excess, xi = self._cooled(state, reached)
        return SpringState(self._ambient + excess, xi)

    def cooling_time(self, state: SpringState, above: float) -> FloatArray:
        """Time until each spring is within `above` [K] of the air, if nothing heats [s], shape (A,)."""
        goal = np.log(np.maximum((state.temperature - self._ambient) / above, 1.0))
        s, time = self._cooling(state, float(goal.max()))
        return np.array([np.interp(g, s, column) for g, column in zip(goal, time.T, strict=True)])

    def _cooling(self, state: SpringState, longest: float) -> tuple[FloatArray, FloatArray]:
        """The time at which cooling springs reach each temperature of a grid, by the heat balance:

        h A dt = m c ds + m L dxi / (T - Ta), with s = ln[(T0 - Ta) / (T - Ta)]. Returns s from 0 to
        `longest`, shape (N,), and times [s], shape (N, A). Only the transformation needs the grid.
        """
        s = np.linspace(0.0, min(longest, _LONGEST), 2 + int(min(longest, _LONGEST) / _GRID))
        excess, xi = self._cooled(state, s[:, None])
        latent = self._latent * np.diff(xi, axis=0) * 2.0 / (excess[1:] + excess[:-1])
        steps = (self._sensible * np.diff(s)[:, None] + latent) / self._loss
        return s, np.concatenate([np.zeros((1, len(self._loss))), np.cumsum(steps, axis=0)])

    def _cooled(self, state: SpringState, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Kelvins above the air and martensite fractions of springs that have cooled to this s."""
        hot = np.maximum(state.temperature - self._ambient, _COLD)
        excess = hot * np.exp(-s)
        before, after = (self._austenite_left(self._ambient + e) for e in (hot, excess))
        left = np.divide(after, before, out=np.zeros_like(after), where=before > 0)
        return excess, 1.0 - (1.0 - state.martensite) * np.minimum(left, 1.0)

    def _austenite_left(self, temperature: FloatArray) -> FloatArray:
        """The cosine 1 - gM, at temperatures of shape (..., A)."""
        angle = (temperature - self._m_finish) * self._freezing
        return (1.0 - np.cos(np.minimum(np.maximum(angle, 0.0), np.pi))) / 2.0


def heat(
    on: BoolArray | FloatArray,
    dt: float,
    parameters: SpringParameters | Sequence[SpringParameters],
    state: SpringState | None = None,
) -> SpringHistory:
    """Temperatures, fractions and lengths of A springs while their contacts switch.

    `on` (T, A): whether the contact is closed in each step of `dt` seconds, or in which fraction of it.
    `parameters`: one for all springs, or one for each. Without `state` the springs start cold. Raises
    `InputError` where shapes do not fit, and for a step that is not positive.

    Each step is the exact exponential for a constant heat capacity, the secant of the transformation over
    this step, so that the heat balance closes. Long steps are divided. The result of a spring has the same
    bits, whatever the number and kind of the others.
    """
    on = np.asarray(on, dtype=np.float64)
    if on.ndim != 2:
        raise InputError("heat: `on` has the wrong shape", expected="(steps, springs)", found=str(on.shape))
    each = [parameters] * on.shape[1] if isinstance(parameters, SpringParameters) else list(parameters)
    if len(each) != on.shape[1]:
        raise InputError(
            "heat: parameters do not fit the springs", expected=str(on.shape[1]), found=str(len(each))
        )
    if not 0 < dt < np.inf:
        raise InputError("heat: the step is wrong", expected="more than 0 s", found=str(dt))
    if state is not None and len(state.temperature) != len(each):
        raise InputError(
            "heat: the state is of other springs", expected=str(len(each)), found=str(len(state.temperature))
        )
    return HeatModel(each).run(on, dt, state)


def time_to(temperature: float, parameters: SpringParameters, limit: float = 600.0) -> float:
    """Time [s] in which a cold spring that stays on reaches `temperature` [C]; infinite if it does not within
    `limit` [s]. Raises `InputError` for what is no temperature or no time."""
    if np.isnan(temperature) or not 0 <= limit < np.inf:
        raise InputError(
            "time_to: no such time",
            expected="a temperature [C] and a limit of 0 s or more",
            found=f"{temperature} C, {limit} s",
        )
    dt = 0.01
    history = heat(np.ones((1, 1)), dt, parameters)
    elapsed = dt
    while history.temperature[-1, 0] < temperature:
        if elapsed >= limit:
            return float("inf")
        history = heat(np.ones((100, 1)), dt, parameters, history.final)
        reached = np.flatnonzero(history.temperature[:, 0] >= temperature)
        elapsed += dt * (reached[0] + 1 if len(reached) else 100)
        if len(reached):
            break
    return elapsed
