"""Who may ask the server for what, by real requests to a real server."""

import http.client
import re
import stat
import sys
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from eldir.errors import InputError, MissingDependencyError
from eldir_app.watch.access import Access
from eldir_app.watch.listening import WatchConfig, serve_page
from eldir_hardware.safety.latch import read_records
from tests.app.watch.bench import watching
from tests.app.watch.malformed import pour
from tests.hardware.emulated_rigs import emulated, rig_file
from tests.raised import raises


def ask(host, method, path, **headers):
    """Status, headers and body of an answer."""
    line = http.client.HTTPConnection(host, timeout=10)
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    line.putrequest(method, path, skip_host="Host" in named)
    for name, value in named.items():
        line.putheader(name, value)
    line.putheader("Content-Length", "0")
    line.endheaders()
    answer = line.getresponse()
    body = answer.read()
    line.close()
    return answer.status, dict(answer.getheaders()), body


@pytest.fixture(scope="module")
def watched(tmp_path_factory):
    with emulated("lcus") as board:
        rig = rig_file(tmp_path_factory.mktemp("watched") / "rig.yaml", "lcus", board.port)
        with watching("--rig", rig) as (address, _):
            yield board, address.removeprefix("http://").strip("/")


@pytest.fixture
def bench(watched):
    """A server at a rig whose channel 3 is closed, and nobody drives it: only a stop opens it."""
    watched[0].set_coil(3, True)
    return watched


def test_only_our_own_page_may_stop(bench):
    board, host = bench
    own = f"http://{host}"
    for headers in (
        {},
        {"Origin": "null"},
        {"Origin": "http://evil.example"},
        {"Origin": own + ".evil.example"},
        {"Origin": own.replace("http", "https")},
        {"Origin": own, "Host": "evil.example"},
        {"Origin": "http://evil.example", "Host": "evil.example"},
        {"Origin": own.replace("127.0.0.1", "localhost")},
        {"Host": ""},
    ):
        assert ask(host, "POST", "/stop", **headers)[0] in (400, 403), headers
    for method in ("GET", "HEAD", "PUT", "DELETE", "OPTIONS"):
        assert ask(host, method, "/stop", Origin=own)[0] == 405
    assert board.contacts[2]
    status, _, body = ask(host, "POST", "/stop", Origin=own)
    assert status == 200 and b'"proven":true' in body and not any(board.contacts)


def test_the_page_may_load_nothing_from_elsewhere(bench):
    _, host = bench
    for path in ("/", "/page.js", "/picture?t=0", "/nothing"):
        _, headers, _ = ask(host, "GET", path)
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy and "unsafe" not in policy and "*" not in policy
        assert headers["x-content-type-options"] == "nosniff" and headers["cache-control"] == "no-store"
    assert ask(host, "GET", "/", Host="evil.example")[0] == 400  # a name that a foreign site has turned to us


def test_the_socket_speaks_to_our_own_page_alone_and_does_not_listen(bench):
    board, host = bench
    for origin in (None, "null", "http://evil.example"):
        with pytest.raises(InvalidStatus, match="403"):
            connect(f"ws://{host}/socket", origin=origin).__enter__()
    with connect(f"ws://{host}/socket", origin=f"http://{host}") as page:
        assert '"rig"' in page.recv(5)
        page.send('{"stop": true}')
        with pytest.raises(ConnectionClosed):
            for _ in range(50):
                page.recv(5)
    assert board.contacts[2]


def test_malformed_requests_and_messages_change_nothing(bench):
    board, host = bench
    assert pour(host, seed=1, count=200) > 60
    assert board.contacts == (False, False, True, False)
    assert ask(host, "GET", "/")[0] == 200
    assert b'"proven":true' in ask(host, "POST", "/stop", Origin=f"http://{host}")[2]


def test_other_addresses_need_the_token(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with emulated("lcus") as board:
        rig = rig_file(tmp_path / "rig.yaml", "lcus", board.port)
        with watching("--rig", rig, "--listen", "0.0.0.0:0") as (address, server):
            host = f"127.0.0.1:{address.strip('/').rpartition(':')[2]}"
            own = {"Origin": f"http://{host}"}
            kept = tmp_path / "state" / "eldir" / ".watch-token"
            token = kept.read_text()
            assert len(token) > 40 and stat.S_IMODE(kept.stat().st_mode) == 0o600
            assert token not in address and token not in server.stdout.readline()
            assert ask(host, "GET", "/")[0] == 200  # asks for the token, and shows nothing
            right = {"Authorization": f"Bearer {token}"}
            for wrong in ({}, {"Cookie": "eldir_watch="}, {"Cookie": f"eldir_watch={token}"},
                          {"Authorization": f"Basic {token}"}, {"Authorization": "Bearer é"}):  # fmt: skip
                assert ask(host, "GET", "/picture?t=0", **wrong)[0] == 401
                assert ask(host, "POST", "/stop", **own, **wrong)[0] == 401
                assert ask(host, "POST", "/enter", **own, **wrong)[0] == 401
            with pytest.raises(InvalidStatus, match="403"):
                connect(f"ws://{host}/socket", origin=own["Origin"]).__enter__()
            status, headers, _ = ask(host, "POST", "/enter", **own, **right)
            cookie = headers["set-cookie"]
            assert (
                status == 204 and "HttpOnly" in cookie and "SameSite=Strict" in cookie and token not in cookie
            )
            value = cookie.partition(";")[0]
            assert ask(host, "GET", "/picture?t=0", Cookie=value)[0] == 404  # allowed; there is none
            with connect(
                f"ws://{host}/socket", origin=own["Origin"], additional_headers={"Cookie": value}
            ) as page:
                assert '"rig"' in page.recv(5)
            assert b'"proven":true' in ask(host, "POST", "/stop", **own, Cookie=value)[2]
        with watching("--rig", rig, "--listen", "0.0.0.0:0", "--stop-without-token") as (address, _):
            host = f"127.0.0.1:{address.strip('/').rpartition(':')[2]}"
            assert ask(host, "GET", "/picture?t=0", Cookie=value)[0] == 404  # the token outlives the server
            assert ask(host, "GET", "/picture?t=0")[0] == 401
            assert b'"proven":true' in ask(host, "POST", "/stop", Origin=f"http://{host}")[2]
        assert not read_records()[
            1
        ]  # the token beside the records is no damaged record, which would forbid heat


@pytest.mark.parametrize(
    ("host", "known"),
    [
        ("127.0.0.1:8642", True), ("localhost:8642", True), ("[::1]:8642", True), ("192.168.1.7:80", True),
        ("192.168.1.7", True), ("bench.lab:8642", True), ("BENCH.LAB", True), ("", False), ("::1", False),
        ("bench.lab.evil.example", False), ("127.0.0.1.evil.example", False), ("localhost:123456", False),
        ("a b", False), ("localhost\n", False), ("[::1", False), ("0x7f000001", False), ("localhost.", False),
    ],
)  # fmt: skip
def test_a_host_is_this_computer_or_refused(host, known):
    assert Access(None, frozenset({"bench.lab"})).knows_host(host) == known


@pytest.mark.parametrize(
    "address", ["8642", "localhost:8642", "127.0.0.1:99999", "127.0.0.1:-1", "1.2.3:80", ":80"]
)
def test_a_wrong_address_is_one_line(address):
    with raises(InputError, "input.wrong-value", "--listen"):
        serve_page(WatchConfig(address=address), print)


@pytest.mark.parametrize(
    ("rig", "log", "said"),
    [
        (
            "none.yaml",
            None,
            "rig; expected a rig file with its port; found cannot read",
        ),
        (
            "empty.yaml",
            None,
            "rig; expected a rig file with its port; found no port",
        ),
        (None, "none.mcap", "none.mcap does not exist"),
        (None, "empty.yaml", "empty.yaml is not an MCAP log"),
        ("empty.yaml", "none.mcap", "give --rig or --log, not both"),
    ],
)
def test_what_cannot_be_watched_is_refused_in_one_line(rig, log, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("empty.yaml").write_text("name: nothing here\n")
    with pytest.raises(InputError, match=re.escape(said)):
        serve_page(WatchConfig(rig and Path(rig), log and Path(log), "127.0.0.1:0"), print)


def test_a_port_that_is_taken_is_refused_in_one_line(watched):
    with raises(InputError, "watch.not-listening", match="Address already in use"):
        serve_page(WatchConfig(address=watched[1]), print)


def test_what_is_missing_is_named(monkeypatch):
    monkeypatch.delitem(sys.modules, "eldir_app.watch.server", raising=False)
    for name in ("starlette", "uvicorn", "websockets"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'eldir\[watch\]'"):
        serve_page(WatchConfig(address="127.0.0.1:0"), print)
