"""What the page on evolution says can be run, runs."""

import re

import pytest

from tests.eldir.evolution.pretended_searches import SMALL, complete_generation
from tests.paths import ROOT

PAGE = (ROOT / "docs" / "reference" / "evolution.md").read_text()


def test_the_python_example_runs(capsys, monkeypatch):
    code = next(c for c in re.findall(r"```python\n(.*?)```", PAGE, re.S) if "search.tell" in c)
    names: dict = {}
    exec(compile(code, "evolution.md", "exec"), names)
    fitness = [float(x) for x in re.findall(r"-?\d+\.\d*(?:e-?\d+)?", capsys.readouterr().out)]
    assert len(fitness) == 16
    assert fitness == sorted(fitness, reverse=True)
    code = next(c for c in re.findall(r"```python\n(.*?)```", PAGE, re.S) if "randomisation=" in c)
    exec(compile(code, "evolution.md", "exec"), names)
    assert names["result"].losses.shape == (16, 6)


def test_the_example_of_a_whole_run_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code = next(c for c in re.findall(r"```python\n(.*?)```", PAGE, re.S) if "resume" in c)
    names: dict = {}
    exec(compile(code, "evolution.md", "exec"), names)
    assert capsys.readouterr().out.split()[::2] == ["0", "1", "2", "3"]
    assert names["designs"][0].morphology.motors <= 2


def test_the_loading_example_runs(tmp_path, monkeypatch):
    from eldir.design import Design
    from eldir.evolution.paper.run_folder import RunFolder

    run = RunFolder.create(tmp_path / "run", SMALL)
    search = run.restore()
    run.save(complete_generation(search))
    monkeypatch.chdir(tmp_path)
    code = next(c for c in re.findall(r"```python\n(.*?)```", PAGE, re.S) if "load_generation" in c)
    exec(compile(code, "evolution.md", "exec"), {})
    best = Design.load(tmp_path / "best.json")
    assert best.provenance["fitness_m"] == pytest.approx(search.archive.ranked()[0].fitness)
