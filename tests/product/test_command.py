"""The command as a user meets it, in real processes."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
import typer

from eldir_app.application import application
from tests.eldir.random_design import make_design
from tests.forked_programs import finished

COMMANDS = ["demo", "evolve", "shortlist", "show", "packet", "gait", "track", "report"]


def eldir(*arguments: str, **options) -> subprocess.CompletedProcess:
    """Started where `options` say how, and forked otherwise: other tests show its start."""
    words = [sys.executable, "-m", "eldir", *map(str, arguments)]
    if not options:
        return finished(words)
    return subprocess.run(words, capture_output=True, text=True, timeout=120, check=False, **options)


ONE_AFTER_ANOTHER = """
import contextlib, io, json, sys
from eldir_app.main import main
results = []
for words in json.loads(sys.argv[1]):
    sys.argv[1:] = words
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        try:
            main()
        except SystemExit as end:
            results.append([words, end.code, "", said.getvalue()])
print(json.dumps(results))
"""


def one_after_another(calls: Sequence[Sequence[str]], folder: Path) -> list[subprocess.CompletedProcess]:
    """Calls of the command in one process: loading what it needs takes longer than all that it then does."""
    words = [sys.executable, "-c", ONE_AFTER_ANOTHER, json.dumps(calls)]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=120, check=True)
    results = [subprocess.CompletedProcess(*result) for result in json.loads(done.stdout)]
    assert len(results) == len(calls) and done.stderr == ""
    return results


def assert_one_line(result: subprocess.CompletedProcess, status: int, *words: str) -> None:
    assert result.returncode == status, result.stderr
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("eldir: ")
    for word in words:
        assert word in lines[0]


def test_help_lists_the_commands_and_loads_nothing_heavy():
    code = (
        "import sys; from eldir_app.application import application; application();"
        "print([m for m in ('taichi', 'trimesh', 'cv2', 'numpy', 'scipy', 'matplotlib', 'pyarrow',"
        " 'rosbags', 'mcap', 'serial') if m in sys.modules]);"
        "import eldir_hardware.planning.compiler, eldir_hardware.run.drive; print('scipy' in sys.modules)"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert loaded.stdout.split() == ["[]", "False"], "a rig is driven without SciPy: half the time to load"
    text = eldir("--help").stdout
    for name in [*COMMANDS, "rig"]:
        assert name in text


def test_the_command_starts_no_threads_of_openblas():
    """They wait in a loop. A thread of a package would be seen too: on one core this shows nothing."""
    code = (
        "import atexit, os, sys; from eldir_app.main import main;"
        "atexit.register(lambda: print('numpy' in sys.modules, len(os.listdir('/proc/self/task'))));"
        "sys.argv[1:] = ['packet', 'none.json', '--out', 'packet']; main()"
    )
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    words = [sys.executable, "-c", code]
    run = subprocess.run(words, capture_output=True, text=True, check=False, env=environment)
    assert (run.stdout, run.returncode) == ("True 1\n", 1), run.stderr
    assert "none.json" in run.stderr


def leaves(command, name):
    """Every command that does something, with its whole name."""
    if not hasattr(command, "commands"):
        yield pytest.param(command, name, id=name)
    for word, below in getattr(command, "commands", {}).items():
        yield from leaves(below, f"{name} {word}")


@pytest.mark.parametrize(("command", "name"), list(leaves(typer.main.get_command(application()), "eldir")))
def test_every_command_explains_itself(command, name):
    assert f"Example: {name} " in command.help
    assert "\n" not in command.help.partition("\n\n")[0], "the list of commands would break the line there"
    assert all(p.help for p in command.params), "each argument and option"
    shown = " ".join(p.display_type(typer.Context(command)) for p in command.params)
    assert "[" not in shown, "types as a shell has them, not those of Python"


def test_help_of_a_command():
    result = eldir("packet", "--help")
    assert result.returncode == 0
    assert "eldir packet" in result.stdout.replace("\n", " ") and "Example" in result.stdout


def test_wrong_arguments_end_with_status_2():
    assert_one_line(eldir("evolve", "--no-such-option"), 2, "no-such-option")
    assert_one_line(eldir("walk"), 2, "walk")
    assert_one_line(eldir("packet", "design.json"), 2, "--out")


@pytest.mark.parametrize("words", [(), ("rig",)])
def test_without_arguments_the_help_is_all_that_is_said(words):
    result = eldir(*words)
    assert result.returncode == 2 and result.stderr == ""
    lines = result.stdout.splitlines()
    assert lines[0].startswith(" ".join(("Usage: eldir", *words))) and "Commands:" in lines


def test_a_missing_file_is_one_line(tmp_path):
    calls = [
        ("packet", "none.json", "--out", "packet"),
        ("show", "none.json", "--out", "picture.png"),
        ("report", "none.mcap", "--design", "none.json", "--out", "report"),
        ("track", "none.mp4", "--out", "track.json"),
        ("shortlist", "none", "--out", "list"),
        ("transfer", "none.json", "--out", "transfer"),
        ("gait", "none.json", "--rig", "none.yaml", "--out", "schedule.json"),
    ]
    for result in one_after_another(calls, tmp_path):
        assert_one_line(result, 1, "none")
    assert list(tmp_path.iterdir()) == []


def test_what_exists_is_not_overwritten_and_a_place_that_cannot_be_written_is_named(tmp_path):
    make_design().save(tmp_path / "design.json")
    (tmp_path / "file").write_text("")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").write_text("kept")
    taken = [(*words, "--out", "out") for words in (("demo",), ("evolve",), ("packet", "design.json"))]
    impossible = ("packet", "design.json", "--out", "file/packet")
    *refused, unwritten = one_after_another([*taken, impossible], tmp_path)
    for result in refused:
        assert_one_line(result, 1, "out", "exists")
    assert_one_line(unwritten, 1, "file/packet")
    assert (tmp_path / "out" / "mine").read_text() == "kept"


def test_the_help_of_the_right_command_is_named():
    assert_one_line(eldir("rig", "walk"), 2, "walk", "see eldir rig --help")
    result = eldir("track", "a.mp4", "--marks", "6")
    assert_one_line(result, 2, "expected at most 5; see eldir track --help")
    assert_one_line(eldir("track", "a.mp4", "--marks", "x"), 2, "expected a whole number")
    result = eldir("evolve", "--objective", "moon")
    assert_one_line(result, 2, "'moon' is not one of")
    assert "Value error" not in result.stderr


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("eldir calib", {"calibrate"}),
        ("eldir calibrate ", {"camera", "plane", "springs", "dynamics"}),
        ("eldir track walk.mp4 --o", {"--out", "--overlay"}),
    ],
)
def test_tab_completes_commands_and_options(typed, offered):
    position = len(typed.split()) - (not typed.endswith(" "))
    asked = {"_ELDIR_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(position)}
    assert set(eldir(env={**os.environ, **asked}).stdout.split()) == offered


def test_completion_is_installed_for_bash_or_the_reason_is_told(tmp_path):
    home = {**os.environ, "HOME": str(tmp_path), "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    result = eldir("--install-completion", "bash", env=home)
    assert result.returncode == 0, result.stderr
    script = next((tmp_path / ".bash_completions").iterdir())
    assert f"source '{script}'" in (tmp_path / ".bashrc").read_text()
    (tmp_path / "file").write_text("")
    home["HOME"] = str(tmp_path / "file")
    assert_one_line(eldir("--install-completion", "bash", env=home), 1, "cannot install completion")


def test_control_c_is_answered_with_a_word():
    code = (
        "import sys, time; import eldir_hardware.rig.configuration as c;"
        "c.Rig.load = lambda path: (print('begun', flush=True), time.sleep(60));"
        "sys.argv[1:] = ['rig', 'doctor', '--rig', 'x.yaml'];"
        "from eldir_app.main import main; main()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "begun\n"
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=60)
    assert process.returncode == 130 and said[1] == "eldir: stopped\n"


def test_control_c_during_an_import_is_not_lost(tmp_path):
    """trimesh catches whatever is raised while it imports SciPy: eldir rig drive drove on to the end."""
    (tmp_path / "inner.py").write_text("import time\nprint('begun', flush=True)\ntime.sleep(3)\n")
    (tmp_path / "outer.py").write_text("try:\n    import inner\nexcept BaseException:\n    pass\n")
    code = (
        "import sys, time; import eldir_hardware.rig.configuration as c;"
        "c.Rig.load = lambda path: (__import__('outer'), print('driven'), time.sleep(60));"
        "sys.argv[1:] = ['rig', 'doctor', '--rig', 'x.yaml'];"
        "from eldir_app.main import main; main()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{os.getcwd()}"},
    ) as process:  # fmt: skip
        assert process.stdout.readline() == "begun\n"
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=30)
    assert process.returncode == 130 and said[1] == "eldir: stopped\n"
