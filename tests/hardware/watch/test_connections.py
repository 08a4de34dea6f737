"""Connections that ask nothing: they end, and do not keep others from being heard."""

import http.client
import json
import socket
import subprocess
import sys
import time
from contextlib import ExitStack

from websockets.sync.client import connect

from hardware.watch.connection import MOST_SILENT
from tests.hardware.guardians import wait

MANY = 300
SERVER = """
import resource, runpy, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (200, 200))
sys.argv = ["eldir", "rig", "watch", *sys.argv[1:]]
runpy.run_module("eldir", run_name="__main__")
"""


def test_a_page_is_served_beside_many_connections_that_ask_nothing():
    """More of them than the server may have open files. A page that is open hears on."""
    words = [sys.executable, "-c", SERVER, "--listen", "127.0.0.1:0"]
    silent: list[socket.socket] = []
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as server, ExitStack() as opened:
        try:
            port = int(server.stdout.readline().strip().rstrip("/").rsplit(":", 1)[1])
            page = opened.enter_context(
                connect(f"ws://127.0.0.1:{port}/socket", origin=f"http://127.0.0.1:{port}")
            )
            silent += [socket.create_connection(("127.0.0.1", port), 5) for _ in range(MANY)]
            begun = time.monotonic()
            assert _status(port) == 200
            assert time.monotonic() - begun < 3.0
            assert wait(lambda: sum(map(_is_open, silent)) <= MOST_SILENT, 5.0)
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
            server.terminate()
            server.wait(10)


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
