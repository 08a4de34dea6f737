"""Programs that are forked are as those that are started: `tests/forked_programs.py`."""

import json
import os
import select
import signal
import subprocess
import sys
import threading

import pytest

from tests.forked_programs import Forked, finished

TELL = """
import json, os, signal, sys, threading
print(json.dumps({
    "process": os.getpid(), "words": sys.argv, "folder": os.getcwd(), "name": __name__,
    "variables": dict(os.environ), "handles": os.listdir("/proc/self/fd"),
    "signals": [str(signal.getsignal(n)) for n in signal.valid_signals()],
    "blocked": [*signal.pthread_sigmask(signal.SIG_BLOCK, [])],
    "group": os.getpgid(0), "session": os.getsid(0), "priority": os.getpriority(os.PRIO_PROCESS, 0),
    "threads": threading.active_count(),
    "streams": [
        [s.encoding, s.errors, s.line_buffering, s.write_through] for s in (sys.stdout, sys.stderr)
    ],
}))
sys.exit(7)
"""
VARIES = ("process", "handles")


@pytest.mark.parametrize("encoding", ["", "iso8859-1", "utf-8:surrogateescape"])
def test_a_program_has_what_it_is_started_with(encoding, tmp_path, monkeypatch):
    """The same as from `subprocess`, but for its number."""
    monkeypatch.setenv("PYTHONIOENCODING", encoding)
    monkeypatch.setenv("ELDIR_OWN", "ü")
    monkeypatch.chdir(tmp_path)
    words = [sys.executable, "-c", TELL, "a", "b c"]
    forked = finished(words)
    started = subprocess.run(words, capture_output=True, text=True, check=False, env=dict(os.environ))
    assert forked.returncode == started.returncode == 7 and forked.stderr == started.stderr == ""
    here, there = json.loads(forked.stdout), json.loads(started.stdout)
    assert {n: v for n, v in here.items() if n not in VARIES} == {
        n: v for n, v in there.items() if n not in VARIES
    }
    assert here["words"] == ["-c", "a", "b c"] and here["process"] != os.getpid()
    assert set(here["handles"]) <= {"0", "1", "2", "3"}, "3 is that of the list itself"
    assert here["variables"]["ELDIR_OWN"] == "ü"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_signals_end_it(number):
    with Forked(
        [sys.executable, "-c", "print(1, flush=True); import time; time.sleep(60)"], stdout=-1
    ) as one:
        assert one.stdout.readline() == "1\n" and one.poll() is None
        with pytest.raises(subprocess.TimeoutExpired):
            one.wait(0.01)
        one.send_signal(number)
        assert one.wait(10) == -number == one.poll()
        one.kill()


def test_what_it_started_outlives_it_and_an_error_is_told():
    code = (
        "import subprocess as s; print(s.Popen(['sleep', '60'], stdout=-3, stderr=-3).pid, flush=True); 1 / 0"
    )
    said = finished([sys.executable, "-c", code])
    assert said.returncode == 1 and said.stderr.endswith("ZeroDivisionError: division by zero\n")
    os.kill(int(said.stdout), signal.SIGKILL)


def test_a_module_runs_as_the_command():
    said = finished([sys.executable, "-m", "eldir", "--version"])
    assert (said.returncode, said.stderr) == (0, "") and said.stdout.startswith("eldir ")


def test_several_threads_start_and_wait():
    statuses = {}

    def start(number: int) -> None:
        with Forked([sys.executable, "-c", f"raise SystemExit({number})"]) as program:
            waiting = [threading.Thread(target=program.wait) for _ in range(3)]
            for one in waiting:
                one.start()
            for one in waiting:
                one.join()
            statuses[number] = program.poll()

    threads = [threading.Thread(target=start, args=[n]) for n in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert statuses == {n: n for n in range(8)}


def test_a_program_for_which_nobody_waits_stops_no_other():
    forgotten = Forked([sys.executable, "-c", "import time; time.sleep(60)"])
    pidfd = os.pidfd_open(forgotten.pid)
    del forgotten
    signal.pidfd_send_signal(pidfd, signal.SIGKILL)
    assert select.select([pidfd], [], [], 10)[0]
    os.close(pidfd)
    assert finished([sys.executable, "-c", "print(1)"]).stdout == "1\n"
