"""What a run folder tells about the gradients that its robots learned from."""

import numpy as np
import pyarrow.parquet as pq
import pytest

from eldir.evolution.loop import evolve, resume
from eldir.evolution.paper import analysis
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.history import read_history
from eldir.evolution.paper.population import flagged_share
from eldir.evolution.paper.robot_tables import FLAGS
from eldir.evolution.paper.run_folder import RunFolder, load_generation
from eldir.evolution.paper.status import describe_flags
from eldir.evolution.status import read_status
from eldir.genotype import unstack
from eldir.lattice import Lattice
from eldir.learning import learn
from eldir.morphology import develop_all
from eldir.scene import Scene
from tests.eldir.evolution.pretended_searches import SMALL
from tests.eldir.evolution.run_folders import go_on

CHAOTIC = Scene.preset("paper").replace(damping=1.0, steps=600)
CONFIG = EvolutionConfig(
    Lattice(4, 6), population=6, generations=1, max_active=2, iterations=2, scene=CHAOTIC
)


def _as_by_an_older_version(run: RunFolder) -> None:
    for path in run.path.glob("*.parquet"):
        table = pq.read_table(path)
        pq.write_table(table.drop_columns(list(FLAGS)), path)


def test_a_run_holds_the_flags_of_what_its_robots_learned_from(tmp_path):
    run = evolve(CONFIG, tmp_path / "run")
    for generation in (0, 1):
        kept = load_generation(run.path, generation)
        bodies = develop_all(CONFIG.lattice, unstack(kept["triangles"], kept["springs"]))
        again = learn(bodies, CHAOTIC, CONFIG.iterations, kept["seed"].tolist())
        assert kept["chaotic_updates"].tolist() == again.chaotic[:, :-1].sum(axis=1).tolist()
        assert kept["rounded_updates"].tolist() == again.rounded[:, :-1].sum(axis=1).tolist()
        assert kept["chaotic_updates"].sum() > 0
        calm = learn(
            bodies, Scene.preset("paper").replace(steps=60), CONFIG.iterations, kept["seed"].tolist()
        )
        assert not calm.chaotic.any(), "the same robots in a short rollout"


def test_the_status_and_the_history_tell_them(tmp_path, monkeypatch):
    run = RunFolder.create(tmp_path / "run", SMALL)
    survivors = go_on(run, run.restore()).archive.ranked()
    status, trend = read_status(run), read_history(run).trend
    for name, share, at_each in (
        ("chaotic_updates", status.chaotic_updates, trend.chaotic),
        ("rounded_updates", status.rounded_updates, trend.rounded),
    ):
        wanted = np.mean([getattr(robot, name) for robot in survivors]) / SMALL.iterations
        assert share == pytest.approx(wanted) and at_each[-1] == share > 0
        assert len(at_each) == SMALL.generations + 1 and np.isfinite(at_each).all()
    assert status.chaotic_updates is not None
    sentence = f"gradients of updates: {100 * status.chaotic_updates:.1f} % dominated by chaos, "
    assert sentence in status.summary()
    written = []  # page and tables; the figures are drawn in test_analysis.py
    monkeypatch.setattr(
        analysis, "write_figures", lambda _, page, figures, numbers: written.append((page, numbers))
    )
    analysis.write_analysis(run, tmp_path / "figures")
    ((page, numbers),) = written
    assert sentence in page
    header, *rows = numbers["generations"].splitlines()
    assert header.endswith(",chaotic,rounded") and float(rows[-1].split(",")[-2]) == pytest.approx(
        status.chaotic_updates
    )


def test_a_run_of_an_older_version_is_read_and_resumed(tmp_path):
    """Of its robots the flags are not known; those of new ones are."""
    whole = evolve(CONFIG, tmp_path / "whole")
    run = evolve(CONFIG, tmp_path / "run")
    for newest in (*run.path.glob("survivors-0001.*"), *run.path.glob("generation-0001.*")):
        newest.unlink()
    _as_by_an_older_version(run)
    status = read_status(run)
    assert status.chaotic_updates is status.rounded_updates is None and "gradients" not in status.summary()
    assert np.isnan(read_history(run).trend.chaotic).all()
    resume(run.path)
    assert load_generation(run.path, 0)["chaotic_updates"].tolist() == [-1] * 6
    wanted = load_generation(whole.path, 1)["chaotic_updates"]
    assert load_generation(run.path, 1)["chaotic_updates"].tolist() == wanted.tolist()
    new = {robot.number >= CONFIG.population: robot for robot in run.read_last_elites()}
    assert set(new) == {True, False}
    for robot in run.read_last_elites():
        assert (robot.chaotic_updates >= 0) == (robot.number >= CONFIG.population)


def test_shares_are_of_what_is_known():
    assert flagged_share(np.array([-1, 2, 4]), 10) == pytest.approx(0.3)
    assert np.isnan(flagged_share(np.array([-1, -1]), 10))
    assert describe_flags(0.0, None) == ""
    assert describe_flags(0.0, 0.25) == "gradients of updates: 25.0 % possibly by rounding"
