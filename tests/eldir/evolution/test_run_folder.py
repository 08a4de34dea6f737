"""Run folders: same seed same bytes, resumed runs end the same, damage is named."""

import json

import jsonschema
import numpy as np
import pyarrow.parquet as pq
import pytest

from eldir.errors import EldirError, InputError
from eldir.evolution.designs import load_run
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.run_folder import RunFolder, load_generation
from eldir.lattice import Lattice
from tests.eldir.evolution.pretended_searches import fitness as fitness_of
from tests.eldir.evolution.run_folders import contents, go_on
from tests.paths import SCHEMAS
from tests.raised import raises

CONFIG = EvolutionConfig(Lattice(4, 6), population=8, generations=4, max_active=2, iterations=3, seed=5)
SCHEMA = SCHEMAS / "run.schema.json"


def test_same_seed_same_bytes(tmp_path):
    for name in ("a", "b"):
        run = RunFolder.create(tmp_path / name, CONFIG)
        go_on(run, run.restore())
    assert contents(tmp_path / "a") == contents(tmp_path / "b")
    assert [*contents(tmp_path / "a")] == [
        *(f"generation-{i:04d}.parquet" for i in range(5)),
        "run.json",
        "survivors-0003.parquet",
        "survivors-0004.parquet",
    ]


@pytest.mark.parametrize("stop", [0, 1, 3])
def test_a_resumed_run_ends_the_same(tmp_path, stop):
    whole = RunFolder.create(tmp_path / "whole", CONFIG)
    go_on(whole, whole.restore())
    stopped = RunFolder.create(tmp_path / "stopped", CONFIG)
    go_on(stopped, stopped.restore(), stop)
    # Interrupted in the middle of the next one: its robots are written, its survivors are not.
    (stopped.path / f"generation-{stop:04d}.parquet").write_bytes(b"half")
    again = RunFolder.open(tmp_path / "stopped")
    assert again == stopped
    search = again.restore()
    assert search.generation == stop
    go_on(again, search)
    assert contents(tmp_path / "stopped") == contents(tmp_path / "whole")


def test_interrupted_between_new_and_old_survivors(tmp_path):
    run = RunFolder.create(tmp_path / "run", CONFIG)
    search = go_on(run, run.restore(), 1)
    kept = (run.path / "survivors-0000.parquet").read_bytes()
    go_on(run, search, 2)
    (run.path / "survivors-0000.parquet").write_bytes(kept)
    assert run.restore().generation == 3


def test_the_configuration_matches_its_schema(tmp_path):
    RunFolder.create(tmp_path / "run", CONFIG)
    values = json.loads((tmp_path / "run" / "run.json").read_text())
    jsonschema.validate(values, json.loads(SCHEMA.read_text()))
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(values | {"format": "eldir-run/2"}, json.loads(SCHEMA.read_text()))


def test_designs_come_best_first_with_their_origin(tmp_path):
    run = RunFolder.create(tmp_path / "run", CONFIG)
    search = go_on(run, run.restore())
    designs = load_run(tmp_path / "run")
    fitness = [d.provenance["fitness_m"] for d in designs]
    assert fitness == fitness_of(search).tolist() == sorted(fitness, reverse=True)
    for design, robot in zip(designs, search.archive.ranked(), strict=True):
        assert design.controller == robot.controller
        assert design.morphology.motors <= 2
        origin = design.provenance
        index = origin["id"] % CONFIG.population
        born = load_generation(run.path, origin["generation"])
        assert born["seed"][index] == origin["seed"]
        assert np.array_equal(born["triangles"][index], design.genotype.triangles)
        assert np.array_equal(born["springs"][index], design.genotype.springs)
        assert -born["losses"][index].min() == origin["fitness_m"]
        assert born["valid"][index]


def test_other_readers_can_read_a_generation(tmp_path):
    run = RunFolder.create(tmp_path / "run", CONFIG)
    go_on(run, run.restore(), 1)
    table = pq.read_table(run.path / "generation-0000.parquet")
    assert table.num_rows == CONFIG.population
    assert table.schema.metadata[b"format"] == b"eldir-generation/1"
    assert len(table["losses"][0].as_py()) == CONFIG.iterations + 1


def test_an_existing_folder_is_refused(tmp_path):
    RunFolder.create(tmp_path / "run", CONFIG)
    with raises(EldirError, "file.exists"):
        RunFolder.create(tmp_path / "run", CONFIG)


def test_damage_is_named_and_the_generation_before_stands_in(tmp_path):
    with raises(InputError, "file.missing"):
        RunFolder.open(tmp_path / "none")
    run = RunFolder.create(tmp_path / "run", CONFIG)
    with raises(InputError, "run.no-generation"):
        load_run(run.path)
    go_on(run, run.restore())
    whole = contents(run.path)
    survivors = run.path / "survivors-0004.parquet"
    flipped = bytearray(survivors.read_bytes())
    flipped[len(flipped) // 3] ^= 1  # one bit of a weight: told by the checksum
    good = survivors.read_bytes()
    for damaged in (b"", b"PAR1", good[: len(good) // 2], bytes(flipped), whole["generation-0000.parquet"]):
        survivors.write_bytes(damaged)
        with raises(InputError, "file.damaged", match=r"survivors-0004.*remove it"):
            load_run(run.path)
    survivors.unlink()
    search = run.restore()
    assert search.generation == 4
    go_on(run, search)
    assert contents(run.path) == whole


def test_a_damaged_generation_is_named_and_the_run_goes_on(tmp_path):
    run = RunFolder.create(tmp_path / "run", CONFIG)
    go_on(run, run.restore(), 3)
    (run.path / "generation-0001.parquet").write_bytes(b"PAR1")
    with raises(InputError, "file.damaged", match=r"generation-0001.*goes on without"):
        load_generation(run.path, 1)
    assert go_on(run, run.restore()).finished


def test_a_wrong_run_json_is_named(tmp_path):
    run = RunFolder.create(tmp_path / "run", CONFIG)
    values = json.loads((run.path / "run.json").read_text())
    for change in ({"config": {}}, {"config": values["config"] | {"population": 0}}, {"config": 3}):
        (run.path / "run.json").write_text(json.dumps(values | change))
        with pytest.raises(InputError, match=r"run\.json"):
            RunFolder.open(run.path)
