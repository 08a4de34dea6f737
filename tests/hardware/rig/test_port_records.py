"""Who holds a port, from a made-up /proc."""

import os
import signal
from pathlib import Path

import pytest

from eldir_hardware.rig import port_holder
from eldir_hardware.rig.port_holder import GuardedPort, Holder, find_holder, list_guarded_ports, signal_holder


@pytest.fixture
def proc(tmp_path, monkeypatch):
    """An empty /proc, and the port of which it tells."""
    folder = tmp_path / "proc"
    folder.mkdir()
    monkeypatch.setattr(port_holder, "_PROC", folder)
    return folder


PORT = "/dev/null"
DEVICE = port_holder._lock_name(os.stat(PORT))


def locks(
    proc: Path, *processes: int, device: str = DEVICE, kind: str = "FLOCK", mode: str = "WRITE"
) -> None:
    lines = [f"{i}: {kind}  ADVISORY  {mode} {p} {device} 0 EOF" for i, p in enumerate(processes, 1)]
    (proc / "locks").write_text("\n".join(["1: POSIX", *lines, "2: -> FLOCK ADVISORY WRITE 7 x"]) + "\n")


def process(
    proc: Path, number: int, *, shows: str | None = "lock:\t1: FLOCK  ADVISORY  WRITE 1 {} 0 EOF", state="S",
    words: bytes = b"",
) -> None:  # fmt: skip
    folder = proc / str(number)
    (folder / "fdinfo").mkdir(parents=True)
    (folder / "fdinfo" / "0").write_text("pos:\t0\n")
    if shows is not None:
        (folder / "fdinfo" / "1").write_text(f"pos:\t0\n{shows.format(DEVICE)}\n")
    (folder / "stat").write_text(f"{number} (a) name) {state} 1 2 3\n")
    (folder / "cmdline").write_bytes(words)


def test_the_process_whose_file_bears_the_lock(proc):
    locks(proc, 11)
    process(proc, 11)
    assert find_holder(PORT) == Holder(11, os.getuid(), False)
    assert find_holder("/dev/zero") is None and find_holder("/dev/no-such-port") is None


@pytest.mark.parametrize(
    ("state", "stopped"), [("S", False), ("R", False), ("T", True), ("t", True), ("?", False)]
)
def test_whether_the_holder_is_suspended(proc, state, stopped):
    locks(proc, 11)
    process(proc, 11, state=state)
    assert find_holder(PORT).suspended is stopped


def test_a_holder_that_has_just_ended(proc, monkeypatch):
    locks(proc, 11)
    monkeypatch.setattr(port_holder, "_shows_lock", lambda *_: True)
    assert find_holder(PORT) == Holder(11, None, False)
    (proc / "11").mkdir()
    (proc / "11" / "stat").write_text("")
    assert find_holder(PORT) == Holder(11, os.getuid(), False)


@pytest.mark.parametrize(
    "shows",
    [
        None,
        "pos: FLOCK WRITE {}",
        "lock:\t1: POSIX  ADVISORY  WRITE 1 {} 0 EOF",
        "lock:\t1: FLOCK  ADVISORY  WRITE 1 {}0 0 EOF",
    ],
)
def test_a_process_without_the_lock_is_no_holder(proc, shows):
    locks(proc, 11)
    process(proc, 11, shows=shows)
    assert find_holder(PORT) is None


def test_locks_of_another_kind(proc):
    process(proc, 11)
    for more in ({"kind": "POSIX"}, {"mode": "READ"}, {"device": "00:00:1"}):
        locks(proc, 11, **more)
        assert find_holder(PORT) is None
    (proc / "locks").unlink()
    assert find_holder(PORT) is None


def test_a_lock_that_another_process_has_inherited(proc):
    locks(proc, 11)
    process(proc, 12, shows=None)
    process(proc, 13)
    (proc / "self").mkdir()
    assert find_holder(PORT).process == 13


def test_processes_whose_files_must_not_be_read(proc, monkeypatch):
    """They may be the holder: the first of them, unless another one is proven to be."""
    locks(proc, 11, 12, 13)
    for number in (11, 12, 13):
        process(proc, number)
    proven: dict[int, bool | None] = {11: None, 12: None, 13: None}
    monkeypatch.setattr(port_holder, "_shows_lock", lambda number, device: proven[number])
    assert find_holder(PORT).process == 11
    proven[13] = True
    assert find_holder(PORT).process == 13


def test_what_the_files_of_a_process_show(proc, monkeypatch):
    process(proc, 11)
    assert port_holder._shows_lock(11, DEVICE) is True
    assert port_holder._shows_lock(12, DEVICE) is False, "it has ended"

    def forbidden(self: Path):
        raise PermissionError

    monkeypatch.setattr(Path, "iterdir", forbidden)
    assert port_holder._shows_lock(11, DEVICE) is None


def test_guardians_by_their_words_and_their_lock(proc):
    locks(proc, 11, 12, 13, 14, 15, 16)
    words = [b"python", b"-I", b"eldir-guardian", b"3", PORT.encode(), b"lcus", b"4", b"/dev/link", b""]
    process(proc, 11, words=b"\0".join(words))
    process(proc, 12, words=b"\0".join([*words[:4], b"/dev/zero", *words[5:]]))
    process(proc, 13, words=b"\0".join([*words[:6], b"four", *words[7:]]))
    process(proc, 14, words=b"eldir-guardian\0003\0")
    process(proc, 15, words=b"\xff\0" + b"\0".join(words))
    found = GuardedPort(11, PORT, "lcus", 4, "/dev/link", DEVICE)
    assert list_guarded_ports() == [found, found._replace(process=15)]


def test_a_guardian_whose_port_was_unplugged_is_known_by_the_lock_that_it_still_holds(proc, tmp_path):
    """The name has gone, or is another device's by now."""
    port = tmp_path / "ttyUSB0"
    port.touch()
    handle, lock = os.open(port, os.O_RDWR), port_holder.get_lock(str(port))
    port.unlink()
    locks(proc, 11, device=lock)
    words = [b"eldir-guardian", b"3", str(port).encode(), b"lcus", b"4", b"/dev/link", b""]
    process(proc, 11, words=b"\0".join(words))
    assert list_guarded_ports() == []
    (proc / "11" / "fd").mkdir()
    (proc / "11" / "fd" / "5").symlink_to(f"/proc/{os.getpid()}/fd/{handle}")
    shown = os.readlink
    readlink = lambda path: shown(f"/proc/self/fd/{handle}") if str(path).endswith("11/fd/5") else shown(path)  # noqa: E731
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "readlink", readlink)
        assert list_guarded_ports() == [GuardedPort(11, str(port), "lcus", 4, "/dev/link", lock)]
        port.touch()
        assert list_guarded_ports() == [GuardedPort(11, str(port), "lcus", 4, "/dev/link", lock)]
    os.close(handle)


def test_signals(proc, monkeypatch):
    """Only to a process that shows the lock behind its pidfd; its file descriptor is closed."""
    me = os.getpid()
    process(proc, me)
    sent = []
    monkeypatch.setattr(signal, "pidfd_send_signal", lambda handle, number: sent.append(number))
    before = len(os.listdir("/proc/self/fd"))
    assert signal_holder(PORT, me, signal.SIGTERM) is True and sent == [signal.SIGTERM]
    assert signal_holder("/dev/zero", me, signal.SIGTERM) is False
    assert signal_holder("/dev/no-such-port", me, signal.SIGTERM) is False
    assert signal_holder(PORT, 2**22 - 1, signal.SIGTERM) is False

    def ended(handle: int, number: int) -> None:
        raise ProcessLookupError

    monkeypatch.setattr(signal, "pidfd_send_signal", ended)
    assert signal_holder(PORT, me, signal.SIGTERM) is False
    assert len(os.listdir("/proc/self/fd")) == before and sent == [signal.SIGTERM]
