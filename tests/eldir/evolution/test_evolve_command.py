"""`eldir evolve` in small real runs: the same bytes on any number of threads, stopped and resumed."""

import json
import signal
import time
from collections.abc import Callable
from typing import get_args

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from eldir.defaults import Ground
from eldir.evolution.designs import load_run
from eldir.evolution.paper.configuration import make_terrain
from eldir.evolution.paper.run_folder import load_generation
from eldir.rollout import simulate
from eldir.show import picture
from eldir_app.commands.evolve import evolve
from eldir_app.commands.show import show
from eldir_app.commands.status import status
from tests.eldir.evolution.evolve_processes import SMALL, contents, start


def _app(command: Callable) -> typer.Typer:
    app = typer.Typer()
    app.command()(command)
    return app


def test_neither_threads_nor_ctrl_c_matter_and_fitness_is_what_the_rollout_shows(tmp_path, monkeypatch):
    """A whole run on one thread; another on three, stopped in its first generations, resumed."""
    stopped = start("--out", tmp_path / "stopped", "--generations", "15", *SMALL, threads=3)
    deadline = time.monotonic() + 200
    while not list(tmp_path.glob("stopped/survivors-*.parquet")) and time.monotonic() < deadline:
        time.sleep(0.01)
    stopped.send_signal(signal.SIGINT)
    _, err = stopped.communicate(timeout=200)
    assert stopped.returncode == 130
    assert f"--resume {tmp_path / 'stopped'}" in " ".join(err.split())
    assert "stopped, " in CliRunner().invoke(_app(status), [str(tmp_path / "stopped")]).output
    assert not (tmp_path / "stopped" / "survivors-0015.parquet").exists()
    again = start("--resume", tmp_path / "stopped", "--json", threads=3)
    told = json.loads(again.communicate(timeout=200)[0])
    assert again.returncode == 0
    assert (told["state"], told["whole"]) == ("finished", 16)
    assert json.loads(CliRunner().invoke(_app(status), [told["path"], "--json"]).output) == told
    monkeypatch.setenv("ELDIR_THREADS", "1")
    words = ["--out", str(tmp_path / "whole"), "--generations", "15", *SMALL]
    first = CliRunner().invoke(_app(evolve), words)
    assert first.exit_code == 0 and "best" in first.output
    assert contents(tmp_path / "stopped") == contents(tmp_path / "whole")
    designs = load_run(tmp_path / "whole")
    show(tmp_path / "whole")
    assert (tmp_path / "whole.png").read_bytes() == picture(designs[0]), (
        "of a folder, the best robot is shown"
    )
    assert (designs[0].lattice.rows, designs[0].lattice.columns) == (4, 6)
    rollouts = simulate([d.morphology for d in designs], [d.controller for d in designs], designs[0].scene)
    for design, rollout in zip(designs, rollouts, strict=True):
        assert -rollout.loss == pytest.approx(design.provenance["fitness_m"], abs=1e-5)
        assert design.morphology.motors <= 2
    assert load_generation(tmp_path / "whole", 15)["losses"].shape == (6, 4)


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["--out", "a", "--resume", "b"],
        ["--resume", "b", "--seed", "1"],
        ["--out", "a", "--lattice", "13"],
        ["--out", "a", "--lattice", "0x4"],
        ["--out", "a", "--terrain", "moon"],
        ["--out", "a", "--population", "0"],
        ["--out", "a", "--crossover", "some"],
    ],
)
def test_wrong_arguments_exit_with_2(arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(_app(evolve), arguments).exit_code == 2
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("ground", get_args(Ground))
def test_every_ground_that_the_command_names_can_be_made(ground):
    assert make_terrain(ground, 1).is_flat == (ground == "flat")


@pytest.mark.parametrize(("ground", "direction"), [("incline", 1), ("decline", -1)])
def test_the_ground_tilts_as_asked_and_depends_on_the_seed_alone(ground, direction):
    terrain = make_terrain(ground, 1)
    assert terrain == make_terrain(ground, 1)
    assert terrain != make_terrain(ground, 2)
    rise = [np.diff(make_terrain(ground, s).height(np.array([0.0, 1.25])))[0] for s in range(20)]
    assert np.sign(np.mean(rise)) == direction
