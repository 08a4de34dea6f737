"""Wrong options, giant numbers and failures at the start: one line, nothing allocated, no folder left."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from eldir.errors import EldirError, InputError
from eldir.evolution.loop import evolve
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.printed.configuration import PrintedEvolutionConfig
from eldir.lattice import Lattice
from eldir_app.application import application
from eldir_hardware.planning.workshop import make_workshop
from eldir_hardware.rig.template import virtual_rig
from tests.raised import raises

GIANT = "1000000000000000"


@pytest.mark.parametrize("objective", ["paper", "printed"])
@pytest.mark.parametrize("option", ["--population", "--generations"])
def test_giant_numbers_are_refused_with_the_range(objective: str, option: str, tmp_path: Path) -> None:
    out = tmp_path / "run"
    result = CliRunner().invoke(
        application("evolve"), ["evolve", "--objective", objective, "--out", str(out), option, GIANT]
    )
    assert result.exit_code == 2
    assert option in result.output and "100" in result.output.replace(GIANT, "")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("values", "code", "key", "most"),
    [
        ({"population": 10**15}, "wrong-value", "population", "100000"),
        ({"generations": 10**15}, "wrong-value", "generations", "1000000"),
        ({"iterations": 10**15}, "wrong-value", "iterations", "100000"),
        (
            {"population": 100_000, "iterations": 100_000},
            "inconsistent",
            "population x iterations",
            "100000000,",
        ),
        (
            {"population": 100_000, "lattice": Lattice(400, 400)},
            "inconsistent",
            "population x rows x columns",
            "100000000,",
        ),
        ({"static_margin": 1e300}, "inconsistent", "EvolutionConfig.static_margin", "at most"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_is_allocated(
    values: dict, code: str, key: str, most: str
) -> None:
    with raises(InputError, f"evolution.{code}", key, match=f" {most}"):
        EvolutionConfig(**values)


@pytest.mark.parametrize(
    ("values", "code", "key", "most"),
    [
        ({"offspring": 10**15}, "wrong-value", "offspring", "100000;"),
        (
            {"offspring": 100_000, "lattice": Lattice(400, 400)},
            "inconsistent",
            "population x rows x columns",
            "100000000,",
        ),
        (
            {"static_margin": 1e300},
            "inconsistent",
            "PrintedEvolutionConfig.static_margin",
            "171 mm .* 11 columns",
        ),
    ],
)
def test_printed_runs_too(values: dict, code: str, key: str, most: str) -> None:
    with raises(InputError, f"printed-evolution.{code}", key, match=f" {most}"):
        PrintedEvolutionConfig(**values)


def test_a_run_that_fails_at_once_leaves_no_folder(tmp_path: Path) -> None:
    impossible = EvolutionConfig(Lattice(1, 3), population=2, static_margin=0.056)
    with raises(EldirError, "evolution.too-few-bodies"):
        evolve(impossible, tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


def test_nor_does_the_command_and_it_promises_nothing_saved(tmp_path: Path) -> None:
    arguments = ["evolve", "--out", str(tmp_path / "run"), "--lattice", "1x3", "--static-margin", "56"]
    result = CliRunner().invoke(application(arguments[0]), [*arguments, "--population", "2"])
    assert "too few bodies" in str(result.exception) and "saved" not in str(result.exception)
    assert list(tmp_path.iterdir()) == []


def test_nor_does_a_run_for_building(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("eldir.evolution.printed.problem._ATTEMPTS", 2)
    arguments = ["evolve", "--objective", "printed", "--out", str(tmp_path / "run"), "--lattice", "1x3"]
    result = CliRunner().invoke(application(arguments[0]), [*arguments, "--static-margin", "56"])
    assert "too few bodies" in str(result.exception)
    assert list(tmp_path.iterdir()) == []


def test_options_that_the_build_filter_would_undo_are_refused(tmp_path: Path) -> None:
    """Limits of `kit/data/parts.yaml`: a margin of 20 mm and two motors."""
    last = "  - {channel: 4, spring: 1, face: back}\n"
    third = "  - {channel: 5, spring: 2, face: front}\n  - {channel: 6, spring: 2, face: back}\n"
    rig_file = tmp_path / "rig.yaml"
    text = virtual_rig(1).replace("  channels: 4", "  channels: 8").replace(last, last + third)
    rig_file.write_text(text)
    assert make_workshop(rig_file).motors == 3
    for option, value, said in (
        ("--static-margin", "19.9", "at least 20 mm: the build filter refuses bodies with less"),
        ("--max-motors", "3", "at most 2: bodies with more cannot be built"),
    ):
        words = ["evolve", "--objective", "printed", "--rig", str(rig_file), option, value]
        found = CliRunner().invoke(application("evolve"), [*words, "--out", str(tmp_path / "run")])
        assert f"expected {said}; found {value}" in str(found.exception)
        assert "\n" not in str(found.exception)
    assert list(tmp_path.iterdir()) == [rig_file]
