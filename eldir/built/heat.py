"""Two-way shape-memory springs heated by a current: heat balance, hysteresis, free length.

    m c dT/dt = I^2 R(xi) - h A (T - T_ambient) + sum of G (T_neighbour - T) + m L dxi/dt

with xi the martensite fraction, which falls while heating (L > 0 is then absorbed). Neighbours are springs at
the same hub; G is 0 by default, and each spring is then a problem of its own. The kinetics are
Liang and Rogers' cosines.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from itertools import combinations
from math import cos, exp, pi

import numpy as np

from eldir.built._kinetics import Kinetics
from eldir.core.arguments import require_count, require_shape, require_value
from eldir.core.records import BoolArray, FloatArray, IntArray, Record
from eldir.parameters.springs import SpringParameters

_SECANTS = 4  # rounds for the heat capacity over a step; a fifth changes T by less than 1e-3 K
_MAX_CHANGE = 2.0  # [K]
_GRID, _MAX_LOGARITHM = 0.01, 16.0  # of the logarithm of cooling: 0.7 K at most; after e^-16 it is as the air
_COLD = 1e-9  # above the air: no spring that cools is colder [K]
_MAX_EXCHANGE = 0.03  # of the difference from its neighbours that a spring may lose in one part of a step
_NEIGHBOURS = 10  # of a spring in the lattice, five at each end: parts do not depend on the bodies in a batch
_FEW = 48  # fewer springs are heated one by one in plain numbers; 4 of them so take a 20th of the time


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


class _Exchange:
    """Heat that passes between springs at the same hub."""

    def __init__(self, conductance: FloatArray, hubs: IntArray):
        """`conductance` of each spring [W/K], shape (A,): a pair has the mean of both. `hubs` of each spring,
        shape (A, 2)."""
        at: dict[int, list[int]] = defaultdict(list)
        for spring, both in enumerate(hubs.tolist()):
            for hub in both:
                at[hub].append(spring)
        pairs = [pair for springs in at.values() for pair in combinations(springs, 2)]
        self._a, self._b = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
        self._conductance = (conductance[self._a] + conductance[self._b]) / 2
        self._count = len(conductance)

    def received(self, temperature: FloatArray) -> FloatArray:
        """Heat that each spring receives from its neighbours [W], shape (A,); its sum is zero."""
        flow, received = (
            self._conductance * (temperature[self._a] - temperature[self._b]),
            np.zeros(self._count),
        )
        np.add.at(received, self._b, flow)
        np.subtract.at(received, self._a, flow)
        return received


def _doubled_cosine(angle: float) -> float:
    """Twice the cosine gA or 1 - gM, at an angle that grows from 0 to pi with the transformation."""
    return 2.0 if angle <= 0.0 else 0.0 if angle >= pi else 1.0 + cos(angle)


class HeatModel:
    """Heat balance of A springs, each with its own parameters, integrated from state to state."""

    def __init__(
        self,
        parameters: Sequence[SpringParameters],
        max_change: float = _MAX_CHANGE,
        hubs: IntArray | None = None,
    ):
        """`max_change`: steps are divided so that no temperature changes by more in one part [K]. `hubs`: see
        `heat`."""
        self._max_change = max_change

        def gather(name: str) -> FloatArray:
            return np.array([getattr(p, name) for p in parameters], dtype=np.float64)

        self._kinetics = Kinetics(parameters)
        self._ambient, self._loss = gather("ambient"), gather("loss")
        self._sensible = gather("mass") * gather("heat_capacity")
        self._latent = gather("mass") * gather("latent_heat")
        self._r_hot = np.array([p.resistance_at(0.0) for p in parameters])
        self._r_change = np.array([p.resistance_at(1.0) for p in parameters]) - self._r_hot
        self._lead, self._voltage = gather("lead_resistance"), gather("supply_voltage")
        self._most = gather("current_limit")
        self._cold, self._hot = gather("cold_length"), gather("hot_length")
        least, greatest = (f(self._r_hot, self._r_hot + self._r_change) for f in (np.minimum, np.maximum))
        kinetics = self._kinetics
        self._numbers = np.array(
            [
                *(self._ambient, self._loss, self._sensible, self._latent),
                *(self._r_hot, self._r_change, self._lead, self._voltage, self._most),
                *(kinetics.low[0], kinetics.scale[0], kinetics.high[1], -kinetics.scale[1]),
            ]
        )
        self._strongest = np.minimum(self._most, self._voltage / least) ** 2 * greatest
        conductance = gather("neighbour_conductance")
        self._exchange_rate = _NEIGHBOURS * float((conductance / self._sensible).max(initial=0.0))  # [1/s]
        self._exchange: _Exchange | None = None
        if hubs is not None:
            require_shape("hubs", np.shape(hubs), (len(conductance), 2))
        if conductance.any() and len(conductance) > 1:
            expected, remedy = "those of each spring, between which heat passes", "pass hubs=body.motor_hubs"
            require_value("hubs", hubs is not None, expected, "none", remedy)
            self._exchange = _Exchange(conductance, np.asarray(hubs))

    def with_ambient(self, ambient: FloatArray) -> HeatModel:
        """The same springs in air of other temperatures [C], shape (A,)."""
        other = copy(self)
        other._ambient = np.asarray(ambient, np.float64)
        other._numbers = np.array([other._ambient, *self._numbers[1:]])
        return other

    def run(
        self, on: BoolArray | FloatArray, dt: float, state: SpringState | None = None, *, many: bool = False
    ) -> SpringHistory:
        """Temperatures, fractions and lengths while contacts switch; see `heat`."""
        on = np.asarray(on, dtype=np.float64)
        if state is None:
            state = SpringState(self._ambient, np.ones(len(self._ambient)))
        heated = on.max(axis=0, initial=0.0) * self._strongest
        strongest = np.maximum(heated, self._loss * np.abs(state.temperature - self._ambient))
        parts = max(1, int(np.ceil((strongest / self._sensible).max(initial=0.0) * dt / self._max_change)))
        parts = max(parts, int(np.ceil(self._exchange_rate * dt / _MAX_EXCHANGE)))
        # With heat between springs every body takes the same way, alone or beside others.
        few = len(state.temperature) < _FEW and not many and self._exchange_rate == 0.0
        way = self._heat_one_by_one if few else self._heat_together
        temperatures, fractions, currents = way(on, dt / parts, parts, state)
        lengths = self._cold + (self._hot - self._cold) * (1.0 - fractions)
        return SpringHistory(temperatures, fractions, lengths, currents)

    def cool(self, state: SpringState, seconds: float) -> SpringState:
        """The springs after `seconds` in which nothing heats them, however long.

        A spring that is colder than the air counts as one of the air's temperature. Raises `InputError`
        where heat passes between springs: then only `run` knows their temperatures.
        """
        self._require_no_exchange()
        s, time = self._cooling(state, float((self._loss / self._sensible).max()) * seconds)
        reached = np.array([np.interp(seconds, column, s) for column in time.T])
        excess, xi = self._cooled(state, reached)
        return SpringState(self._ambient + excess, xi)

    def cooling_time(self, state: SpringState, above: float) -> FloatArray:
        """Time until each spring is within `above` [K] of the air, if nothing heats [s], shape (A,). Raises
        `InputError` where heat passes between springs."""
        self._require_no_exchange()
        goal = np.log(np.maximum((state.temperature - self._ambient) / above, 1.0))
        s, time = self._cooling(state, float(goal.max()))
        return np.array([np.interp(g, s, column) for g, column in zip(goal, time.T, strict=True)])

    def _require_no_exchange(self) -> None:
        alone = self._exchange is None
        require_value("neighbour_conductance", alone, "0 W/K where springs cool in one step")

    def _cooling(self, state: SpringState, longest: float) -> tuple[FloatArray, FloatArray]:
        """The time at which cooling springs reach each temperature of a grid, by the heat balance:

        h A dt = m c ds + m L dxi / (T - Ta), with s = ln[(T0 - Ta) / (T - Ta)]. Returns s from 0 to
        `longest`, shape (N,), and times [s], shape (N, A). Only the transformation needs the grid.
        """
        s = np.linspace(0.0, min(longest, _MAX_LOGARITHM), 2 + int(min(longest, _MAX_LOGARITHM) / _GRID))
        excess, xi = self._cooled(state, s[:, None])
        latent = self._latent * np.diff(xi, axis=0) * 2.0 / (excess[1:] + excess[:-1])
        steps = (self._sensible * np.diff(s)[:, None] + latent) / self._loss
        return s, np.concatenate([np.zeros((1, len(self._loss))), np.cumsum(steps, axis=0)])

    def _cooled(self, state: SpringState, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Kelvins above the air and martensite fractions of springs that have cooled to this s."""
        hot = np.maximum(state.temperature - self._ambient, _COLD)
        excess = hot * np.exp(-s)
        before, after = (self._kinetics.austenite_left(self._ambient + e) for e in (hot, excess))
        left = np.divide(after, before, out=np.zeros_like(after), where=before > 0)
        return excess, 1.0 - (1.0 - state.martensite) * np.minimum(left, 1.0)

    def _heat_together(self, on: FloatArray, dt: float, parts: int, state: SpringState) -> FloatArray:
        """Temperatures, fractions and currents after every `parts` steps of `dt` [s], shape (3, T, A)."""
        temperature, xi = state.temperature, state.martensite
        cosines = self._kinetics.cosines(temperature)
        found = np.empty((3, *on.shape))
        for t, closed in enumerate(on):
            charge = np.zeros(len(temperature))
            for _ in range(parts):
                resistance = self._r_hot + self._r_change * xi
                current = np.minimum(self._most, self._voltage / (resistance + self._lead))
                heat, now = closed * current**2 * resistance, (temperature, xi, cosines)
                if self._exchange is not None:  # Heun's method: the mean of what flows before and after
                    received = self._exchange.received(temperature)
                    then, _, _ = self._step(*now, heat + received, dt)
                    heat = heat + (received + self._exchange.received(then)) / 2
                temperature, xi, cosines = self._step(*now, heat, dt)
                charge += closed * current / parts
            found[:, t] = temperature, xi, charge
        return found

    def _step(
        self, temperature: FloatArray, xi: FloatArray, cosines: FloatArray, heat: FloatArray, dt: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Temperatures, fractions and cosines after `dt` [s] in which each spring gets this heat [W]."""
        loss, sensible, kinetics = self._loss, self._sensible, self._kinetics
        target = self._ambient + heat / loss
        heating = target > temperature
        capacity = sensible
        for _ in range(_SECANTS):
            after = target + (temperature - target) * np.exp(-loss * dt / capacity)
            cosines_after = kinetics.cosines(after)
            xi_after = kinetics.fraction(xi, cosines, heating, cosines_after)
            if not (changed := xi_after != xi).any():
                break
            rise = after - temperature
            secant = np.divide(xi_after - xi, rise, out=np.zeros_like(xi), where=changed & (rise != 0))
            capacity = sensible - self._latent * secant
        return after, xi_after, cosines_after

    def _heat_one_by_one(self, on: FloatArray, dt: float, parts: int, state: SpringState) -> FloatArray:
        """What `_heat_together` finds. Springs that are alike and heated alike are computed once."""
        found = np.empty((3, *on.shape))
        begin = np.concatenate([self._numbers, [state.temperature, state.martensite]])
        known: dict[bytes, FloatArray] = {}
        for a, (numbers, closed) in enumerate(zip(begin.T, on.T, strict=True)):
            key = numbers.tobytes() + closed.tobytes()
            if key not in known:
                known[key] = np.array(_heat_one(numbers.tolist(), closed.tolist(), dt, parts))
            found[:, :, a] = known[key]
        return found


def _heat_one(numbers: list[float], on: list[float], dt: float, parts: int) -> tuple[list[float], ...]:
    """Temperatures, fractions and currents of one spring."""
    ambient, loss, sensible, latent, r_hot, r_change, lead, voltage, most, *kinetics = numbers
    a_start, a_scale, m_start, m_scale, temperature, xi = kinetics
    temperatures, fractions, currents = [], [], []
    free = exp(-loss * dt / sensible)
    for closed in on:
        charge = 0.0
        for _ in range(parts):
            target = ambient
            if closed:
                resistance = r_hot + r_change * xi
                current = voltage / (resistance + lead)
                current = current if current < most else most
                target = ambient + closed * current**2 * resistance / loss
                charge += closed * current / parts
            after, xi_after = target + (temperature - target) * free, xi
            heating = target > temperature
            rest, start, scale = (xi, a_start, a_scale) if heating else (1.0 - xi, m_start, m_scale)
            if rest:
                before, decay = _doubled_cosine((temperature - start) * scale), free
                for _ in range(_SECANTS):
                    after = target + (temperature - target) * decay
                    angle = (after - start) * scale  # as in _doubled_cosine
                    left = 2.0 if angle <= 0.0 else 0.0 if angle >= pi else 1.0 + cos(angle)
                    ratio = (left / before if left < before else 1.0) if before else 0.0
                    xi_after = xi * ratio if heating else 1.0 - rest * ratio
                    if xi_after == xi or after == temperature:
                        break
                    capacity = sensible - latent * ((xi_after - xi) / (after - temperature))
                    decay = exp(-loss * dt / capacity)
            temperature, xi = after, xi_after
        temperatures.append(temperature)
        fractions.append(xi)
        currents.append(charge)
    return temperatures, fractions, currents


def heat(
    on: BoolArray | FloatArray,
    dt: float,
    parameters: SpringParameters | Sequence[SpringParameters],
    state: SpringState | None = None,
    *,
    many: bool = False,
    hubs: IntArray | None = None,
) -> SpringHistory:
    """Temperatures, fractions and lengths of A springs while their contacts switch.

    `on` (T, A): whether the contact is closed in each step of `dt` seconds, or in which fraction of it.
    `parameters`: one for all springs, or one for each. Without `state` the springs start cold. `hubs`: the
    two hubs of each spring, shape (A, 2), such as `body.motor_hubs`; springs at the same hub pass heat to
    each other if they have a `neighbour_conductance`. Raises `InputError` where shapes do not fit, for a step
    that is not positive, and where heat passes between springs whose hubs are not given.

    Each step is the exact exponential for a constant heat capacity, the secant of the transformation over
    this step, so that the heat balance closes. Long steps are divided. Few springs are computed in another
    way than many, with other rounding; `many` takes the way of many, so that a spring's result does not
    depend on their number. Springs that pass heat always take the way of many.
    """
    on = np.asarray(on, dtype=np.float64)
    require_shape("on", on.shape, (None, None))
    each = [parameters] * on.shape[1] if isinstance(parameters, SpringParameters) else list(parameters)
    require_count("parameters", len(each), on.shape[1], "spring")
    require_value("dt", 0 < dt < np.inf, "more than 0 s", dt)
    if state is not None:
        require_count("temperatures in the state", len(state.temperature), len(each), "spring")
    return HeatModel(each, hubs=hubs).run(on, dt, state, many=many)


def join_hubs(robots: Sequence[IntArray]) -> IntArray:
    """The hubs of the springs of all robots, shape (A, 2), for springs that are heated side by side: no two
    robots have one in common."""
    above = np.cumsum([0, *(1 + int(hubs.max(initial=-1)) for hubs in robots)])
    return np.concatenate([hubs + first for hubs, first in zip(robots, above, strict=False)])


def austenite_after_loop(min_c: float, max_c: float, parameters: SpringParameters) -> float:
    """Austenite fraction of a cold spring that was heated once to `max_c` and cooled to `min_c` [C].

    The kinetics forget where the temperature reversed, so that a swing that repeats transforms a little more
    each time; real springs return to the same fraction (return-point memory). This is what the first swing
    leaves.
    """
    kinetics = Kinetics([parameters])
    (left_by_heating, hot), (_, cold) = (kinetics.cosines(np.array([t]))[:, 0] for t in (max_c, min_c))
    return float((1.0 - left_by_heating) * min(1.0, cold / hot)) if hot > 0 else 0.0


def heating_time(temperature: float, parameters: SpringParameters, limit: float = 600.0) -> float:
    """Time [s] in which a cold spring that stays on reaches `temperature` [C]; infinite if it does not within
    `limit` [s]. Raises `InputError` for an invalid temperature or time."""
    require_value("temperature", not np.isnan(temperature), "a number [C]", temperature)
    require_value("limit", 0 <= limit < np.inf, "0 s or more", limit)
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
