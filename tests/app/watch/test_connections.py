"""Connections that end no request: the server ends them, and they keep no Stop from being heard."""

import http.client
import json
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import pytest
from websockets.sync.client import connect

from tests.app.watch.crowd import KINDS, crowd
from tests.forked_programs import Forked
from tests.hardware.emulated_rigs import emulated, rig_file, wait

MANY = 300
FEW, USUAL = 200, 1024  # files that a server may have open
SERVER = """
import resource, runpy, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (int(sys.argv[1]), int(sys.argv[1])))
sys.argv = ["eldir", "rig", "watch", *sys.argv[2:]]
runpy.run_module("eldir", run_name="__main__")
"""


def test_a_page_is_served_beside_many_connections_that_ask_nothing():
    """More of them than the server may have open files. A page that is open hears on."""
    silent: list[socket.socket] = []
    with served(FEW) as port, ExitStack() as opened:
        try:
            page = opened.enter_context(
                connect(f"ws://127.0.0.1:{port}/socket", origin=f"http://127.0.0.1:{port}")
            )
            silent += [socket.create_connection(("127.0.0.1", port), 5) for _ in range(MANY)]
            begun = time.monotonic()
            assert _status(port) == 200
            assert time.monotonic() - begun < 3.0
            assert wait(lambda: sum(map(_is_open, silent)) <= FEW // 2, 5.0)
            half = silent[-1]
            half.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n")  # no end
            assert _is_open(half)
            assert wait(lambda: not any(map(_is_open, silent)), 14.0), "after ten seconds all have ended"
            assert _status(port) == 200
            begun = time.monotonic()
            while time.monotonic() < begun + 1.5:  # what has come meanwhile is read at once
                assert json.loads(page.recv(timeout=2.0)) is not None
        finally:
            for each in silent:
                each.close()


CROWDS = [("slow body", 1)]
OTHERS = [(kind, addresses) for kind in KINDS for addresses in (1, 1024) if (kind, addresses) not in CROWDS]


@pytest.mark.parametrize(
    ("kind", "addresses"), [*CROWDS, *(pytest.param(*each, marks=pytest.mark.stress) for each in OTHERS)]
)
def test_a_stop_is_answered_beside_a_crowd_that_ends_no_request(kind, addresses, tmp_path, monkeypatch):
    """1024 connections, opened again whenever they are ended; a Stop from elsewhere, one from their midst."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with emulated("lcus") as board:
        rig = rig_file(tmp_path / "rig.yaml", "lcus", board.port)
        with served(USUAL, "--rig", rig) as port:
            _stop(port, "127.0.0.1")
            with crowd(port, kind, 1024, addresses):
                for source in ("127.8.8.8", "127.0.1.1"):
                    time.sleep(3.0)  # the next process that stops has loaded
                    board.set_coil(3, True)
                    took = _stop(port, source)
                    print(f"{kind} from {addresses}: {took:.2f} s")
                    assert not any(board.contacts) and took < 1.0


def test_a_request_is_answered_and_ended_whatever_body_it_announces():
    with served(USUAL) as port:
        for more in ("Content-Length: 99999999999", "Transfer-Encoding: chunked", "Expect: 100-continue"):
            with socket.create_connection(("127.0.0.1", port), 5) as line:
                line.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n{more}\r\n\r\n".encode())
                answer = b""
                while data := line.recv(1 << 16):
                    answer += data
            assert answer.startswith(b"HTTP/1.1 200") and b"connection: close" in answer.lower()


@contextmanager
def served(files: int, *words: object) -> Iterator[int]:
    """The port of a server that may have few open files."""
    command = [sys.executable, "-c", SERVER, str(files), "--listen", "127.0.0.1:0", *map(str, words)]
    with Forked(command, stdout=subprocess.PIPE) as server:
        try:
            yield int(server.stdout.readline().strip().rstrip("/").rsplit(":", 1)[1])
        finally:
            server.terminate()
            server.wait(10)


def _stop(port: int, source: str) -> float:
    """How long a person at this address waits for the proof that everything is off [s]."""
    begun = time.monotonic()
    phone = http.client.HTTPConnection("127.0.0.1", port, timeout=30, source_address=(source, 0))
    phone.request("POST", "/stop", headers={"Origin": f"http://127.0.0.1:{port}"})
    answer = json.loads(phone.getresponse().read())
    assert answer["proven"], answer
    return time.monotonic() - begun


def _status(port: int) -> int:
    page = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    page.request("GET", "/")
    return page.getresponse().status


def _is_open(connection: socket.socket) -> bool:
    connection.setblocking(False)
    try:
        return connection.recv(1) != b""
    except BlockingIOError:
        return True
    except OSError:
        return False
