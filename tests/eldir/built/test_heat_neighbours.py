"""Heat that passes between springs at a hub: exact solutions, conservation, and who passes the hubs."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eldir.built.gait import Gait, free_lengths, free_lengths_batch
from eldir.built.heat import HeatModel, SpringState, heat, heating_time, join_hubs
from eldir.built.robot import build
from eldir.built.samples import NominalRobots, sample_walks
from eldir.built.screening import screen
from eldir.built.walking import walk
from eldir.errors import InputError
from eldir.evolution.printed.trials import Trial, screen_gaits
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import develop
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from tests.raised import raises

PAIR, CHAIN = np.array([[0, 1], [1, 2]]), np.array([[0, 1], [2, 1], [3, 2], [7, 8]])
P = SpringParameters(neighbour_conductance=0.02)
ALONE = SpringParameters()
GAIT = Gait(20.0, np.array([0.0, 0.5]), np.full(2, 0.3))


GENOTYPES = random_genotypes(Lattice(3, 6), 40, np.random.default_rng(10), max_active=2)
BODIES = MEETING, APART = [
    develop(Lattice(3, 6), GENOTYPES[i]) for i in (10, 34)
]  # two motors each; they stand
assert len(np.unique(MEETING.motor_hubs)) == 3 and len(np.unique(APART.motor_hubs)) == 4


def exact(
    capacity: np.ndarray, loss: np.ndarray, exchange: np.ndarray, heated: np.ndarray, excess: np.ndarray,
    times: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Kelvins above the air of springs that do not transform, C dx/dt = P - K x, by the eigenvectors of K
    after scaling with the capacities."""
    root = np.sqrt(capacity)
    k = (np.diag(loss) + np.diag(exchange.sum(axis=1)) - exchange) / np.outer(root, root)
    values, vectors = np.linalg.eigh(k)
    settled = vectors @ ((vectors.T @ (heated / root)) / values) / root
    begun = vectors.T @ (root * (excess - settled))
    return settled + (np.exp(-np.outer(times, values)) * begun) @ vectors.T / root


def linear(seed: int, conductance: float) -> list[SpringParameters]:
    """Four springs that never transform, of different sizes and losses."""
    rng = np.random.default_rng(seed)
    never = {"austenite_start": 400.0, "austenite_finish": 410.0, "martensite_start": -90.0}
    return [
        replace(
            ALONE, **never, martensite_finish=-95.0, turns=float(rng.uniform(15, 30)),
            convection_fan=float(rng.uniform(50, 200)), current_limit=float(rng.uniform(1, 4)),
            neighbour_conductance=conductance * factor,
        )
        for factor in (1.0, 0.5, 2.0, 1.0)
    ]  # fmt: skip


@pytest.mark.parametrize("conductance", [1e-3, 0.02, 0.3])
@pytest.mark.parametrize("seed", [1, 2])
def test_springs_in_a_row_do_what_the_exact_solution_does(conductance, seed):
    """The row is 0 - 1 - 2; spring 3 hangs elsewhere. Heated from the start, each by its own supply."""
    springs = linear(seed, conductance)
    begun = SpringState(np.array([90.0, 25.0, 40.0, 60.0]), np.ones(4))
    exchange = np.zeros((4, 4))
    for a, b, mean in ((0, 1, 0.75), (1, 2, 1.25)):
        exchange[a, b] = exchange[b, a] = mean * conductance
    on = np.tile([1.0, 0.0, 0.4, 1.0], (160, 1))
    capacity, loss, power = np.array([[p.mass * p.heat_capacity, p.loss, p.power(1.0)] for p in springs]).T
    excess, times = begun.temperature - ALONE.ambient, 0.05 * np.arange(1, 161)
    wanted = exact(capacity, loss, exchange, on[0] * power, excess, times)
    found = heat(on, 0.05, springs, begun, hubs=CHAIN).temperature - ALONE.ambient
    assert np.abs(found - wanted).max() < 2e-4
    without = heat(on, 0.05, [replace(p, neighbour_conductance=0.0) for p in springs], begun).temperature
    assert np.abs(without - ALONE.ambient - wanted)[:, :3].max() > 100 * 2e-4


def test_the_error_falls_with_the_square_of_the_step():
    springs, excess = linear(3, 2e-3)[:2], np.array([68.0, 3.0])
    begun = SpringState(ALONE.ambient + excess, np.ones(2))
    capacity, loss = np.array([[p.mass * p.heat_capacity, p.loss] for p in springs]).T
    exchange = 1.5e-3 * (1 - np.eye(2))
    (wanted,) = ALONE.ambient + exact(capacity, loss, exchange, np.zeros(2), excess, np.array([4.0]))
    errors = []
    for dt in (0.4, 0.2, 0.1):  # which are not divided
        model = HeatModel(springs, max_change=1e9, hubs=PAIR)
        found = model.run(np.zeros((round(4 / dt), 2)), dt, begun).final.temperature
        errors.append(np.abs(found - wanted).max())
    assert errors[0] < 1e-2
    assert np.array(errors[:-1]) / errors[1:] == pytest.approx([4, 4], rel=0.1)


@settings(max_examples=15, deadline=None)
@given(
    on=st.lists(st.tuples(*[st.booleans()] * 4, st.integers(5, 80)), min_size=1, max_size=5),
    conductance=st.sampled_from([1e-3, 0.02, 0.5]),
    fan=st.booleans(),
    latent=st.sampled_from([0.0, 12_200.0]),
)
def test_energy_balances_while_springs_transform(on, conductance, fan, latent):
    """What all of them were given is lost or stored: nothing appears or vanishes between them."""
    p = replace(P, neighbour_conductance=conductance, fan=fan, latent_heat=latent)
    closed = np.concatenate([np.tile(row[:4], (row[4], 1)) for row in on]).astype(float)
    history = heat(closed, 0.05, p, hubs=CHAIN)
    assert history.martensite.min() >= 0 and history.martensite.max() <= 1
    heated = float((history.current**2).sum()) * p.resistance * 0.05
    t = np.vstack([np.full(4, p.ambient), history.temperature]) - p.ambient
    lost = p.loss * 0.05 * float((t[1:] + t[:-1]).sum()) / 2
    stored = p.mass * float((p.heat_capacity * t[-1] + p.latent_heat * (1 - history.martensite[-1])).sum())
    assert stored + lost == pytest.approx(heated, rel=4e-3, abs=1e-3)


@given(st.integers(0, 10_000))
@settings(max_examples=10)
def test_a_warm_neighbour_only_warms_and_the_names_of_hubs_do_not_matter(seed):
    rng = np.random.default_rng(seed)
    on = (rng.random((20, 2)) < 0.5).repeat(10, 0)
    on[:, 1] = 0
    history = heat(on, 0.05, P, hubs=PAIR)
    alone = heat(on, 0.05, ALONE)
    assert (history.temperature[:, 1] >= alone.temperature[:, 1] - 1e-9).all()
    assert (history.temperature[:, 0] <= alone.temperature[:, 0] + 1e-9).all()
    for hubs in ([[7, 4], [4, 900]], [[4, 7], [900, 4]]):
        assert heat(on, 0.05, P, hubs=np.array(hubs)) == history
    turned = heat(on[:, ::-1], 0.05, P, hubs=PAIR)
    assert np.array_equal(turned.temperature[:, ::-1], history.temperature)


def test_springs_that_are_alike_pass_no_heat():
    on = np.tile((np.arange(400) % 200 < 60)[:, None], (1, 2))
    assert heat(on, 0.05, P, hubs=PAIR) == heat(on, 0.05, ALONE, many=True)


def test_springs_at_other_hubs_are_alone():
    rng = np.random.default_rng(4)
    on = (rng.random((40, 4)) < 0.4).repeat(10, 0)
    found, alone = heat(on, 0.05, P, hubs=CHAIN), heat(on, 0.05, ALONE, many=True)
    assert np.array_equal(found.temperature[:, 3], alone.temperature[:, 3])
    assert (np.ptp(found.temperature - alone.temperature, axis=0)[:3] > 0.5).all()


@pytest.mark.parametrize("many", [False, True])
def test_robots_side_by_side_are_heated_as_if_alone(many):
    """To the last bit: of different bodies, and more springs than are computed one by one."""
    rng = np.random.default_rng(0)
    bodies = [MEETING, APART] * 14
    robots = [
        (
            replace(GAIT, phase=rng.random(2)),
            [replace(P.perturb(rng), neighbour_conductance=float(g)) for g in rng.uniform(0.001, 0.03, 2)],
        )
        for _ in bodies
    ]
    together = free_lengths_batch(robots, 1, many=many, hubs=[b.motor_hubs for b in bodies])
    for robot, body, found in zip(robots[:2], bodies[:2], together[:2], strict=True):
        assert found == free_lengths_batch([robot], 1, many=many, hubs=[body.motor_hubs])[0]
        assert found == free_lengths(*robot, 1, hubs=body.motor_hubs)


def test_joined_robots_have_no_hub_in_common():
    joined = join_hubs([PAIR, np.zeros((0, 2), int), CHAIN])
    assert joined.tolist() == [[0, 1], [1, 2], [3, 4], [5, 4], [6, 5], [10, 11]]


def test_without_conductance_hubs_change_nothing():
    on = np.random.default_rng(1).random((300, 2))
    assert heat(on, 0.05, ALONE, hubs=PAIR) == heat(on, 0.05, ALONE)


def test_files_without_the_conductance_are_read_and_written():
    values = ALONE.to_json()
    assert "neighbour_conductance" not in values and SpringParameters.from_json(values) == ALONE
    assert P.to_json()["neighbour_conductance"] == 0.02 and SpringParameters.from_json(P.to_json()) == P
    assert SpringParameters.mean([P, ALONE]).neighbour_conductance == 0.01
    assert P.perturb(np.random.default_rng(1)).neighbour_conductance == 0.02


def test_a_body_that_is_not_known_is_refused():
    """Instead of an answer in which no heat passes."""
    with raises(InputError, "input.wrong-value", "hubs"):
        heat(np.ones((3, 2)), 0.1, P)
    with raises(InputError, "input.wrong-value", "hubs"):
        HeatModel([P, ALONE])
    with raises(InputError, "input.wrong-value", "hubs"):
        free_lengths(GAIT, P, cycles=1)
    with raises(InputError, "input.wrong-shape", "hubs"):
        heat(np.ones((3, 2)), 0.1, P, hubs=CHAIN)
    with raises(InputError, "input.wrong-number", "hubs"):
        free_lengths_batch([(GAIT, [P, P])], 1, hubs=[])
    model, state = HeatModel([P, P], hubs=PAIR), SpringState.cold(2, P)
    with raises(InputError, "input.wrong-value", "neighbour_conductance"):
        model.cool(state, 1.0)
    with raises(InputError, "input.wrong-value", "neighbour_conductance"):
        model.cooling_time(state, 1.0)
    for value in (-1e-3, 1.5, np.nan):
        with raises(InputError, "spring-parameters.wrong-value", "neighbour_conductance"):
            SpringParameters(neighbour_conductance=value)


def test_a_single_spring_has_no_neighbour():
    assert heat(np.ones((99, 1)), 0.05, P) == heat(np.ones((99, 1)), 0.05, ALONE, many=True)
    assert heating_time(60.0, P) == pytest.approx(heating_time(60.0, ALONE), abs=1e-9)
    state = SpringState(np.array([60.0]), np.zeros(1))
    assert HeatModel([P]).cooling_time(state, 1.0) == HeatModel([ALONE]).cooling_time(state, 1.0)


def walk_alone(springs: SpringParameters) -> np.ndarray:
    return walk([build(body) for body in BODIES], GAIT, springs, cycles=1)[:, None]


def walk_samples(springs: SpringParameters) -> list[np.ndarray]:
    robots = [NominalRobots(body, RobotParameters(springs=springs)) for body in BODIES]
    return [sample_walks(each, [GAIT], 2, cycles=1)[0].displacement for each in robots]


def walk_in_trials(springs: SpringParameters) -> np.ndarray:
    trials = [Trial(body, (GAIT,) * 8, (1, 2)) for body in BODIES]
    return screen_gaits(trials, RobotParameters(springs=springs))


def walk_in_all_phases(springs: SpringParameters) -> list[np.ndarray]:
    return [found.displacement for found in screen(BODIES, springs=springs, phases=2)]


@pytest.mark.slow(30)
@pytest.mark.parametrize(
    "simulate",
    [
        walk_alone,
        walk_samples,
        walk_in_trials,
        pytest.param(walk_in_all_phases, marks=pytest.mark.stress),
    ],
)
def test_what_simulates_robots_knows_which_of_their_springs_meet(simulate):
    before, after = simulate(ALONE), simulate(replace(P, neighbour_conductance=0.03))
    stands = [np.isfinite(a) & np.isfinite(b) for a, b in zip(before, after, strict=True)]
    assert all(each.any() for each in stands)
    meeting, apart = (np.abs(b[k] - a[k]).max() for a, b, k in zip(before, after, stands, strict=True))
    assert meeting > 1e-2 and apart < 1e-4
