"""-v, -vv and ELDIR_LOG as a user meets them: results on stdout, what the program does on stderr."""

import json
import os
import pty
import re
import subprocess
import sys
from contextlib import suppress

import pytest

from tests.hardware.emulated_rigs import emulated, rig_file

ELDIR = [sys.executable, "-m", "eldir"]
LINE = re.compile(r"\d\d:\d\d:\d\d\.\d{3} (DEBUG  |INFO   |WARNING) (.+?) ([a-z_]+(?:\.[a-z_]+)+): (.+)")


def eldir(*words: object, log: str | None = None, **options) -> subprocess.CompletedProcess:
    others = {name: value for name, value in os.environ.items() if name != "ELDIR_LOG"}
    return subprocess.run(
        [*ELDIR, *map(str, words)],
        capture_output=True, text=True, timeout=120, check=False,
        env=others if log is None else others | {"ELDIR_LOG": log}, **options,
    )  # fmt: skip


def lines(result: subprocess.CompletedProcess) -> list[tuple[str, str, str, str]]:
    """Level, program, module and message of each line."""
    found = [LINE.fullmatch(line) for line in result.stderr.splitlines()]
    assert all(found), result.stderr
    return [(level.strip(), *rest) for level, *rest in (match.groups() for match in found)]


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    """`eldir rig new` without the option, with it before and behind its name, and twice."""
    folder = tmp_path_factory.mktemp("rigs")
    words = {"quiet": (), "before": ("-v",), "behind": (), "twice": ("-v",), "two": ()}
    ends = {"behind": ("-v",), "twice": ("--verbose",), "two": ("-vv",)}
    return {
        name: eldir(*start, "rig", "new", "--out", f"{name}.yaml", *ends.get(name, ()), cwd=folder)
        for name, start in words.items()
    }


def test_without_the_option_only_the_result_is_written(said):
    quiet = said["quiet"]
    assert quiet.returncode == 0 and quiet.stderr == "" and quiet.stdout == "wrote quiet.yaml\n"


@pytest.mark.parametrize("how", ["twice", "two"])
def test_the_option_adds_lines_on_stderr_alone(how, said):
    assert said[how].returncode == 0 and said[how].stdout == f"wrote {how}.yaml\n"
    found = lines(said[how])
    assert ("DEBUG", "eldir", "eldir.core.files") in [line[:3] for line in found]
    assert any(text.startswith(f"wrote {how}.yaml (") for *_, text in found)
    assert all(
        module.split(".")[0] in ("eldir", "eldir_app", "eldir_hardware", "eldir_cad", "eldir_calibration")
        for _, _, module, _ in found
    )


@pytest.mark.parametrize("how", ["before", "behind"])
def test_one_v_writes_no_details(how, said):
    assert said[how].stdout == f"wrote {how}.yaml\n"
    assert all(level == "INFO" for level, *_ in lines(said[how]))


def test_json_stays_json():
    found = json.loads(eldir("info", "--json", "-vv").stdout)
    assert isinstance(found, dict)


@pytest.mark.parametrize(
    ("value", "problem"),
    [
        ("loud", "expected error, warning, info, debug, or MODULE=LEVEL, separated by commas; found 'loud'"),
        (
            "hardwear.relay=debug",
            "expected an installed module or package before =, .*; found 'hardwear.relay'",
        ),
    ],
)
def test_a_wrong_variable_is_one_line(value, problem):
    result = eldir("info", log=value)
    assert result.returncode == 1 and result.stdout == ""
    assert re.fullmatch(f"eldir: invalid ELDIR_LOG; {problem}\n", result.stderr)


def test_a_wrong_variable_keeps_no_board_on(tmp_path):
    with emulated("lcus") as board:
        result = eldir("rig", "off", "--port", board.port, "--board", "lcus", log="loud")
        assert result.returncode == 0 and "channels are open by the board's report" in result.stdout
        assert re.fullmatch("eldir: invalid ELDIR_LOG; .*; only warnings are written\n", result.stderr)


@pytest.mark.parametrize(
    "words", [("-vv", "rig", "off"), ("rig", "off", "-vv"), ("rig", "-v", "off", "--verbose")]
)
def test_the_emergency_stop_takes_the_option_and_its_short_way(words, tmp_path):
    """It does not load the command line for it."""
    with emulated("lcus") as board:
        result = eldir(*words, "--port", board.port, "--board", "lcus")
    assert result.returncode == 0, result.stderr
    found = lines(result)
    assert {program for _, program, _, _ in found} == {"eldir rig off"}, "the way that loads no other command"
    off = [text for _, _, module, text in found if module == "eldir_hardware.safety.off_frames"]
    assert off[0].startswith(f"to {board.port}: a0 01 00 a1")


def test_one_module_alone(tmp_path):
    with emulated("lcus") as board:
        path = rig_file(tmp_path / "rig.yaml", "lcus", board.port)
        result = eldir("rig", "reset", "--rig", path, log="eldir_hardware.relay=debug,warning")
    assert result.returncode == 0
    found = lines(result)
    assert {module for _, _, module, _ in found} == {"eldir_hardware.relay.line"}
    assert any(text == f"to {board.port}: a0 01 00 a1" for *_, text in found)


def test_an_error_has_one_line_at_any_level(tmp_path):
    quiet, loud = (eldir(*v, "show", "none.json", cwd=tmp_path) for v in ((), ("-vv",)))
    assert quiet.stderr == "eldir: none.json does not exist; check the path\n"
    assert loud.stderr.endswith(quiet.stderr) and loud.stderr.count("does not exist") == 1


def test_on_a_terminal_the_lines_are_those_of_rich(tmp_path):
    host, guest = pty.openpty()
    others = {name: value for name, value in os.environ.items() if name != "ELDIR_LOG"}
    with subprocess.Popen(
        [*ELDIR, "-vv", "rig", "new", "--out", "rig.yaml"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=guest, text=True,
        env=others | {"COLUMNS": "200", "TERM": "xterm-256color"},
    ) as program:  # fmt: skip
        os.close(guest)
        shown = b""
        with suppress(OSError):  # the other end is closed
            while part := os.read(host, 4096):
                shown += part
        assert program.communicate()[0] == "wrote rig.yaml\n"
    os.close(host)
    plain = re.sub(r"\x1b\[[0-9;]*m", "", shown.decode())
    assert "\x1b[" in shown.decode(), "in colour"
    assert re.search(
        r"^\d\d:\d\d:\d\d\.\d{6} DEBUG +eldir\.core\.files: wrote rig\.yaml \(\d+ bytes\)", plain, re.M
    )
