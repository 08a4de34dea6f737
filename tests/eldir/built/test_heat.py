"""Springs: closed forms of heating and cooling, conservation of energy, hysteresis."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eldir.built.heat import HeatModel, SpringState, austenite_after_loop, heat, heating_time
from eldir.errors import InputError
from eldir.parameters.springs import SpringParameters
from tests.raised import raises

P = SpringParameters()


def periodic(period: float, on: float, cycles: int, dt: float) -> np.ndarray:
    steps = round(period / dt)
    return np.tile((np.arange(steps) * dt < on - 1e-9)[:, None], (cycles, 1))


def test_the_built_robots_spring():
    assert P.mass == pytest.approx(1.56e-3, rel=0.01)
    assert P.stiffness(1.0) == pytest.approx(49, rel=0.02)
    assert P.stiffness(0.0) == pytest.approx(124, rel=0.01)
    assert P.steady_temperature == pytest.approx(104, abs=0.5)
    wire = np.pi * 6.5e-3 * 26.7
    assert P.resistance == pytest.approx(0.8e-6 * wire / (np.pi * 0.375e-3**2))


def test_a_period_of_twenty_seconds():
    history = heat(periodic(20, 6, 3, 0.05), 0.05, P)
    peaks = history.temperature.reshape(3, -1).max(axis=1)
    assert peaks.min() >= 76 and peaks.max() <= 79.5
    assert history.temperature[-1, 0] == pytest.approx(30, abs=0.5)
    assert history.length.min() == pytest.approx(P.cold_length, abs=1e-5)
    assert history.length.max() == pytest.approx(P.hot_length, abs=1e-9)


def test_cooling_without_transformation_is_exponential():
    state = SpringState(np.array([95.0, 28.0]), np.array([0.0, 1.0]))
    history = heat(np.zeros((40, 2)), 0.05, P, state)
    tau = P.mass * P.heat_capacity / P.loss
    t = 0.05 * np.arange(1, 41)
    for i, start in enumerate((95.0, 28.0)):
        exact = P.ambient + (start - P.ambient) * np.exp(-t / tau)
        assert np.allclose(history.temperature[:, i], exact, rtol=0, atol=1e-9)


@settings(max_examples=15)
@given(
    wire=st.sampled_from([0.1e-3, 0.75e-3, 3e-3]),
    loss=st.floats(2.0, 150.0),
    latent=st.sampled_from([0.0, 12_200.0, 40_000.0]),
    ambient=st.sampled_from(
        [18.0, 30.0, 38.0]
    ),  # cooling ends below Mf, at it, and within the transformation
    above=st.floats(0.0, 90.0),
    martensite=st.floats(0.0, 1.0),
    part=st.floats(0.0, 8.0),
)
def test_cooling_for_any_time_at_once_is_what_small_steps_find(
    wire, loss, latent, ambient, above, martensite, part
):
    p = replace(P, wire_diameter=wire, coil_diameter=6 * wire, convection_still=loss, fan=False)
    p = replace(p, latent_heat=latent, ambient=ambient)
    model = HeatModel([p, P], max_change=0.2)
    begun = SpringState(np.array([ambient + above, 60.0]), np.array([martensite, 0.0]))
    tau = p.mass * p.heat_capacity / p.loss
    if part > 0.01:
        small = model.run(np.zeros((300, 2)), part * tau / 300, begun).final
        found = model.cool(begun, part * tau)
        assert np.allclose(found.temperature, small.temperature, rtol=0, atol=0.02)
        assert np.allclose(found.martensite, small.martensite, rtol=0, atol=0.002)
    time = model.cooling_time(begun, 2.0)
    assert model.cool(begun, float(time[0])).temperature[0] == pytest.approx(
        ambient + min(above, 2.0), abs=1e-3
    )
    assert (time[0] == 0) == (above <= 2.0) and time[1] > 0


def test_springs_as_cold_as_the_air_or_colder_need_no_time_to_cool():
    cold = SpringState(np.array([P.ambient, P.ambient - 5.0, P.ambient]), np.array([1.0, 0.5, 0.0]))
    model = HeatModel([P, P, replace(P, latent_heat=0.0)])
    assert model.cooling_time(cold, 2.0).tolist() == [0.0, 0.0, 0.0]
    for seconds in (0.0, 1.0, 1e6):
        found = model.cool(cold, seconds)
        assert (
            found.temperature == pytest.approx([P.ambient] * 3, abs=1e-8)
            and np.isfinite(found.martensite).all()
        )


def test_held_on_it_settles_where_heat_balances():
    history = heat(np.ones((400, 1)), 0.5, P)
    assert history.temperature[-1, 0] == pytest.approx(P.steady_temperature, abs=1e-6)
    assert P.power(0.0) == pytest.approx(P.loss * (P.steady_temperature - P.ambient))


def test_a_bare_spring_on_a_stiff_supply():
    # 20 mm of close coils of 6.5 mm outer diameter: 0.87 Ohm, 12.6 A, 0.30 s from 22 to 60 C.
    bare = replace(P, fan=False, coil_diameter=5.75e-3, current_limit=1e3, lead_resistance=0.0)
    assert bare.resistance == pytest.approx(0.87, abs=0.005)
    assert bare.current() == pytest.approx(12.6, abs=0.1)
    history = heat(np.ones((60, 1)), 0.01, bare)
    assert 0.01 * np.searchsorted(history.temperature[:, 0], 60.0) == pytest.approx(0.30, abs=0.02)


def test_kinetics_follow_the_cosines_on_the_major_loop():
    up = heat(np.ones((600, 1)), 0.02, P)
    t, xi = up.temperature[:, 0], up.martensite[:, 0]
    inside = (t > 45) & (t < 60)
    assert np.allclose(xi[inside], 0.5 * (np.cos(np.pi * (t[inside] - 45) / 15) + 1), atol=1e-9)
    assert inside.sum() > 20
    down = heat(np.zeros((2000, 1)), 0.02, P, up.final)
    t, xi = down.temperature[:, 0], down.martensite[:, 0]
    inside = (t > 30) & (t < 45)
    assert np.allclose(xi[inside], 0.5 * (np.cos(np.pi * (t[inside] - 30) / 15) + 1), atol=1e-9)


def test_minor_loop_starts_from_the_turning_point():
    on = np.zeros((1200, 1))
    on[:160] = 1  # turns within the transformation
    history = heat(on, 0.02, P)
    turn = int(history.temperature[:, 0].argmax())
    xi = history.martensite[:, 0]
    assert 0.05 < xi[turn] < 0.95
    above_start = np.flatnonzero(history.temperature[turn:, 0] > P.martensite_start) + turn
    assert np.ptp(xi[above_start]) < 1e-12, "nothing transforms back above Ms"
    assert np.all(np.diff(xi[turn:]) >= 0)


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.tuples(st.booleans(), st.integers(1, 60)), min_size=1, max_size=5),
    st.sampled_from([0.02, 0.05, 0.2]),
    st.booleans(),
    st.floats(0.5, 12),
)
def test_energy_balances_and_fractions_stay_fractions(pattern, dt, fan, current):
    """Heat in = heat lost + heat stored, with the loss integrated by the trapezoid from a fine history."""
    parameters = replace(P, fan=fan, current_limit=current)
    on = np.concatenate([np.full(n, state) for state, n in pattern])[:, None]
    history = heat(on, dt, parameters)
    assert history.martensite.min() >= 0 and history.martensite.max() <= 1
    parts = round(dt / 0.01)
    fine = heat(on.repeat(parts, axis=0), 0.01, parameters)
    assert np.abs(fine.temperature[parts - 1 :: parts] - history.temperature).max() < 0.2
    heated = float((history.current**2).sum()) * parameters.resistance * dt
    t = np.vstack([[parameters.ambient], fine.temperature])[:, 0]
    lost = parameters.loss * 0.01 * float(((t[1:] + t[:-1]) / 2 - parameters.ambient).sum())
    end = history.final
    stored = parameters.mass * (
        parameters.heat_capacity * (end.temperature[0] - parameters.ambient)
        + parameters.latent_heat * (1 - end.martensite[0])
    )
    assert stored + lost == pytest.approx(heated, rel=2e-3, abs=1e-3)


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 150), st.integers(0, 2**32 - 1))
def test_continuing_is_the_same_as_going_on(split, seed):
    rng = np.random.default_rng(seed)
    on = rng.random((151, 3)) < 0.5
    each = [P.perturb(rng) for _ in range(3)]
    whole = heat(on, 0.05, each)
    first = heat(on[:split], 0.05, each)
    second = heat(on[split:], 0.05, each, first.final)
    assert np.array_equal(whole.temperature, np.vstack([first.temperature, second.temperature]))
    alone = heat(on[:, 1:2], 0.05, each[1])
    assert np.allclose(alone.length, whole.length[:, 1:2], rtol=0, atol=1e-15)


@given(st.integers(0, 10_000), st.sampled_from([0.02, 0.3, 2.0]))
@settings(max_examples=12)
def test_many_springs_do_what_few_do(seed, dt):
    """The model counts in arrays where there are many springs, and one by one where there are few."""
    rng = np.random.default_rng(seed)
    springs = [replace(P.perturb(rng), current_limit=c) for c in rng.uniform(1.0, 6.0, 4)]
    springs = [
        replace(p, resistivity_martensite=0.9e-6, latent_heat=0.0 if seed % 5 == 0 else 12e3) for p in springs
    ]
    on = np.repeat(rng.choice([0.0, 0.4, 1.0], (6, 4)), 5, axis=0)
    state = SpringState(rng.uniform(22.0, 90.0, 4), rng.choice([0.0, 0.3, 1.0], 4))
    few = heat(on, dt, springs, state)
    crowd = SpringState(np.tile(state.temperature, 12), np.tile(state.martensite, 12))
    crowded = heat(np.tile(on, (1, 12)), dt, springs * 12, crowd)
    many = heat(on, dt, springs, state, many=True)
    for name, exact in (("temperature", 1e-9), ("martensite", 1e-10), ("length", 1e-11), ("current", 1e-10)):
        found = getattr(many, name)
        assert abs(found - getattr(few, name)).max() < exact, name
        assert np.array_equal(np.tile(found, (1, 12)), getattr(crowded, name)), name


def test_a_step_ten_times_smaller_changes_nothing_that_matters():
    coarse = heat(periodic(20, 6, 2, 0.05), 0.05, P).temperature[1::2]
    fine = heat(periodic(20, 6, 2, 0.005), 0.005, P).temperature[19::20]
    assert np.abs(coarse - fine).max() < 0.02


def test_time_to_a_temperature():
    assert heating_time(60.0, P) == pytest.approx(4.3, abs=0.1)
    assert heating_time(P.steady_temperature + 1, P, limit=100) == np.inf


@pytest.mark.parametrize("wanted", [22.5, 30.0, 47.0, 60.0, 90.0])
def test_time_to_a_temperature_is_the_first_step_at_which_a_spring_that_stays_on_has_it(wanted):
    step = 0.01
    history = heat(np.ones((3000, 1)), step, P).temperature[:, 0]
    took = round(heating_time(wanted, P) / step)
    assert history[took - 1] >= wanted  # the first entry is after one step
    assert took == 1 or history[took - 2] < wanted


def test_specimens_differ_but_not_much():
    rng = np.random.default_rng(3)
    ratio = [P.perturb(rng).resistance / P.resistance for _ in range(200)]
    assert 0.015 < np.std(ratio) < 0.025 and max(ratio) <= 1.04 + 1e-12
    assert P.with_resistance(1.2).resistance == pytest.approx(1.2)


def test_bad_input_is_named():
    with raises(InputError, "spring-parameters.wrong-value", "heat_capacity"):
        SpringParameters(heat_capacity=-1.0)
    with raises(InputError, "spring-parameters.inconsistent", "SpringParameters.austenite_start"):
        SpringParameters(austenite_start=61.0)
    with raises(InputError, "input.wrong-shape", "on"):
        heat(np.ones(3), 0.1, P)


@pytest.mark.parametrize("max_c", [48.0, 53.0, 57.0, 65.0])
@pytest.mark.parametrize("min_c", [25.0, 36.0, 44.0])
def test_one_loop_leaves_what_the_integrated_spring_has(min_c: float, max_c: float) -> None:
    """Heated without a pause until it is as hot, cooled until it is as cold."""
    hot = heat(np.ones((round(heating_time(max_c, P) / 0.01), 1)), 0.01, P)
    cold = heat(np.zeros((6000, 1)), 0.01, P, hot.final)
    at = int(np.flatnonzero(cold.temperature[:, 0] <= min_c)[0])
    assert hot.temperature.max() == pytest.approx(max_c, abs=0.1)
    left = austenite_after_loop(min_c, max_c, P)
    assert left == pytest.approx(1 - cold.martensite[at, 0], abs=0.01)


def test_swings_that_repeat_never_leave_less_than_the_first() -> None:
    """The kinetics add to it in each swing; a real spring would not."""
    power = 0.37  # of the full power, in pulses of 0.37 s
    late = heat(np.tile((np.arange(100) < 100 * power)[:, None], (400, 1)).astype(float), 0.01, P)
    low, high = late.temperature[-100:].min(), late.temperature[-100:].max()
    first = austenite_after_loop(float(low), float(high), P)
    assert P.austenite_start < low < high < P.austenite_finish
    assert first < 0.8 and 1 - late.martensite[-100:].max() > 0.99
