"""Painted bodies: networks develop, vary and cross as NEAT's, and runs keep them."""

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from eldir.controller import CPGS
from eldir.errors import InputError
from eldir.evolution.designs import load_run
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.cppn import Cppn, node_number
from eldir.evolution.paper.cppn_variation import cross, mutate, random_network
from eldir.evolution.paper.painting import CppnEncoding
from eldir.evolution.paper.run_folder import RunFolder
from eldir.lattice import Lattice
from eldir.learning import initial_controllers
from eldir.morphology import develop
from eldir.scene import Scene
from tests.eldir.evolution.pretended_searches import SMALL as PRETENDED
from tests.eldir.evolution.pretended_searches import search_for
from tests.eldir.evolution.run_folders import contents, go_on
from tests.raised import raises

LATTICES = st.builds(Lattice, st.integers(1, 7), st.integers(2, 9))
SEEDS = st.integers(0, 2**32 - 1)
CONFIG = EvolutionConfig.from_json(PRETENDED.to_json() | {"encoding": "cppn", "crossover": "neat"})


def grown(seed: int, mutations: int = 12) -> list[Cppn]:
    """A network and its descendants."""
    rng = np.random.default_rng(seed)
    line = [random_network(rng)]
    for _ in range(mutations):
        line.append(mutate(line[-1], rng))
    return line


@settings(max_examples=30, deadline=None)
@given(LATTICES, SEEDS, st.sampled_from(["none", "neat"]), st.sampled_from([None, 1, 2, 5]))
def test_every_network_paints_a_body(lattice, seed, crossover, max_active):
    """In one piece, filled, with a motor and not too many, as `develop` requires; on every lattice."""
    encoding, rng = CppnEncoding(lattice, crossover, max_active), np.random.default_rng(seed)
    genomes = encoding.random(5, rng)
    children, parents = encoding.make_offspring(genomes, rng)
    for genotype in encoding.develop([*genomes, *children]):
        body = develop(lattice, genotype)  # raises where unfilled, empty or in pieces
        assert 1 <= body.motors <= (max_active or len(body.springs))
    assert crossover == "neat" or (parents[:, 0] == parents[:, 1]).all()


@settings(max_examples=30, deadline=None)
@given(SEEDS)
@example(3_318_410_567)  # a single child has no gene of the other parent alone
def test_crossover_aligns_genes(seed):
    """A network crossed with itself is itself. Otherwise the structure is the fitter one's, and every gene is
    that of a parent."""
    rng, line = np.random.default_rng(seed), grown(seed)
    fitter, other = line[-1], mutate(line[4], np.random.default_rng(seed + 1))
    assert cross(fitter, fitter, rng) == fitter
    child = cross(fitter, other, rng)
    assert np.array_equal(child.links, fitter.links) and np.array_equal(child.nodes, fitter.nodes)
    genes = [
        set(zip(map(tuple, n.links.tolist()), n.weights, n.enabled, strict=True)) for n in (fitter, other)
    ]
    children = [child, *(cross(fitter, other, rng) for _ in range(20))]  # each gene comes from either
    of_child = {
        gene
        for one in children
        for gene in zip(map(tuple, one.links.tolist()), one.weights, one.enabled, strict=True)
    }
    assert of_child <= genes[0] | genes[1] and of_child & (genes[1] - genes[0])


def test_the_same_innovation_has_the_same_number():
    """In relatives that do not know each other, because the number follows from the link that was split; a
    second split of the same link is another node."""
    ancestor, families = grown(3, 0)[0], []
    for seed in (1, 2):
        rng, found = np.random.default_rng(seed), set()
        for _ in range(150):
            child = mutate(ancestor, rng)
            for node in set(child.nodes.tolist()) - set(ancestor.nodes.tolist()):
                (source,) = child.links[child.links[:, 1] == node, 0]
                (target,) = child.links[child.links[:, 0] == node, 1]
                assert node == node_number(int(source), int(target), ())
                found.add(node)
        families.append(found)
    assert families[0] & families[1] and families[0] != families[1]
    again = node_number(0, 4, ())
    assert again != node_number(0, 4, {again}) != node_number(0, 5, {again})


def test_a_network_is_evaluated_as_the_formula():
    """Two inputs, a hidden Gaussian, and a link that is not used."""
    network = Cppn(
        np.array([4, 5, 6, 99]), np.array([2, 4, 0, 1]),
        np.array([[0, 5], [0, 99], [1, 99], [2, 6], [3, 4], [99, 4]]),
        np.array([0.5, 1.5, -0.7, 2.0, 0.3, 1.2]), np.array([1, 1, 1, 1, 0, 1], bool),
    )  # fmt: skip
    places = np.random.default_rng(1).uniform(-1, 1, (20, 2))
    x, y = places.T
    hidden = 2 * np.exp(-((1.5 * x - 0.7 * y) ** 2)) - 1
    wanted = np.stack([np.tanh(1.2 * hidden), 0.5 * x, np.sin(2 * np.hypot(x, y))], axis=1)
    np.testing.assert_allclose(network.paint(places), wanted, rtol=1e-14)
    links = np.array([[98, 99], [99, 98]])
    with raises(InputError, "input.wrong-value", "links of a network", match="circle"):
        Cppn(np.array([4, 5, 6, 98, 99]), np.zeros(5), links, np.ones(2), np.ones(2, bool))
    with raises(InputError, "input.wrong-value", "nodes of a network"):
        Cppn(np.array([4, 5]), np.zeros(2), links, np.ones(2), np.ones(2, bool))


def test_motors_begin_as_waves_with_painted_phases():
    """The controller as the paper writes it, with weak hidden weights and without senses, against the wave of
    each painted phase."""
    lattice, scene = Lattice(4, 6), Scene.preset("paper")
    encoding, network = CppnEncoding(lattice), grown(8)[-1]
    body = develop(lattice, encoding.develop([network])[0])
    fresh = initial_controllers([body], scene, [5])[0]
    start = encoding.initial_controller(network, body, fresh)
    np.testing.assert_allclose(np.linalg.norm(start.w2, axis=1), np.linalg.norm(fresh.w2, axis=1))
    generators = np.arange(CPGS) * 2 * np.pi / CPGS
    t = scene.omega * scene.dt * np.arange(200)[:, None]
    drive = np.tanh(1e-4 * np.sin(t + generators) @ start.w1[:, :CPGS].T) @ start.w2.T
    middles = lattice.vertices[lattice.springs[body.lattice_springs[body.active]]].mean(axis=1)
    size = lattice.vertices.max(axis=0) - lattice.vertices.min(axis=0)
    middle = (lattice.vertices.max(axis=0) + lattice.vertices.min(axis=0)) / 2
    scale = np.array([1.0, np.sqrt(3)])
    phases = np.pi * network.paint((middles - middle) * scale / (size * scale).max() * 2)[:, 2]
    waves = np.sin(t + phases)
    for motor in range(body.motors):
        assert np.corrcoef(drive[:, motor], waves[:, motor])[0, 1] > 0.9, motor
    assert np.ptp(phases) > 0.5


def test_networks_go_through_the_tables_of_a_run(tmp_path):
    encoding, networks = CppnEncoding(Lattice(4, 6)), [line[-1] for line in map(grown, range(6))]
    assert encoding.read(pa.table(encoding.columns(networks))) == networks
    run = RunFolder.create(tmp_path / "run", CONFIG)
    search = go_on(run, run.restore(), 3)
    restored = RunFolder.open(run.path).restore()
    for one, other in zip(search.archive.ranked(), restored.archive.ranked(), strict=True):
        assert one.genome == other.genome and one.genotype == other.genotype
        assert CppnEncoding(CONFIG.lattice, "neat", 2).develop([one.genome])[0] == one.genotype
    go_on(run, restored)
    whole = RunFolder.create(tmp_path / "whole", CONFIG)
    go_on(whole, whole.restore())
    assert contents(run.path) == contents(whole.path)
    assert [d.genotype for d in load_run(run.path)] == [r.genotype for r in run.read_last_elites()]


def test_learning_starts_from_the_painted_phases():
    search = search_for(CONFIG)
    (part,) = search.ask().parts(np.arange(12), 12)
    encoding = CppnEncoding(CONFIG.lattice, "neat", 2)
    fresh = initial_controllers(part.bodies, CONFIG.scene, part.seeds)
    for robot, body, own, start in zip(part.robots, part.bodies, fresh, part.controllers, strict=True):
        assert start == encoding.initial_controller(robot.genome, body, own) != own


@pytest.mark.parametrize(("encoding", "crossover"), [("direct", "neat"), ("cppn", "joint")])
def test_a_crossover_of_another_encoding_is_refused(encoding, crossover):
    with raises(
        InputError, "evolution.inconsistent", "EvolutionConfig.crossover", match=f"encoding {encoding}"
    ):
        EvolutionConfig(encoding=encoding, crossover=crossover)
