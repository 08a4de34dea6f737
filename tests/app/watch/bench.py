"""Programs: a run that heats an emulated board, and the server of the page."""

import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import wraps
from pathlib import Path
from typing import NamedTuple

from eldir_hardware.emulator.board import EmulatedBoard
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.safety.latch import read_stop
from eldir_hardware.safety.switch_off import OFF_REASON
from tests.forked_programs import Forked
from tests.hardware.emulated_rigs import emulated, rig_file, wait
from tests.hardware.rigs_and_schedules import gait, rig_text
from tests.hardware.run.faults import guardian_of

ELDIR = [sys.executable, "-m", "eldir"]


class BusyError(Exception):
    """The run ended by itself: this computer is too busy for its emulated board, which then looks dead."""


def again_where_busy(test):
    """A test that has up to four runs to do what it does with one."""

    @wraps(test)
    def tried(*args, tmp_path, **named):
        for attempt in range(3):
            with suppress(BusyError):
                return test(*args, tmp_path=tmp_path / f"attempt{attempt}", **named)
        return test(*args, tmp_path=tmp_path / "last", **named)

    return tried


class Heating(NamedTuple):
    """A run that heats."""

    board: EmulatedBoard
    player: Forked
    rig: Path
    log: Path

    def stopped_after(self, begun: float, seconds: float = 5.0) -> float:
        """From `begun` [s, monotonic] until the last contact was open."""
        assert wait(lambda: not any(self.board.contacts), seconds), self.board.contacts
        time.sleep(0.05)
        assert not any(self.board.contacts)
        return max(edge.t for edge in self.board.contact_events) - begun


def save_schedule(rig: Path, path: Path, cycles: int = 5) -> None:
    """A contact is closed for the first eleven seconds of every twenty: one motor after the other."""
    rig_ = Rig.load(rig)
    plan = compile_schedule(gait(phase=(0.0, 0.27), duty=(0.275, 0.275)), rig_, (0, 1), cycles)
    with_digests(replace(plan, settle_s=0.2, conditioning_cycles=0), rig_).save(path)


@contextmanager
def heating(folder: Path, kind: str = "lcus", **changes: object) -> Iterator[Heating]:
    """`eldir rig drive` on an emulated board, from the moment when a contact is closed. `changes`: entries of
    its rig file."""
    folder.mkdir(parents=True, exist_ok=True)
    with emulated(kind) as board:
        rig = rig_file(folder / "rig.yaml", kind, board.port, name=f"bench of {folder.name}", **changes)
        save_schedule(rig, folder / "schedule.json")
        log = folder / "log.mcap"
        words = [str(folder / "schedule.json"), "--rig", str(rig), "--log", str(log)]
        with Forked(
            [*ELDIR, "rig", "drive", *words],
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            child_guardian=True,  # the page takes a guardian's parent for the program
        ) as player:  # fmt: skip
            try:
                assert wait(lambda: any(board.contacts) or player.poll() is not None, 25.0)
                yield Heating(board, player, rig, log)
            except Exception as error:
                if player.poll() is not None and OFF_REASON not in (read_stop(board.port) or ""):
                    raise BusyError(player.stderr.read()) from error
                raise
            finally:
                for process in (player.pid, guardian_of(board)):
                    if process is not None:
                        with suppress(ProcessLookupError):
                            os.kill(process, signal.SIGCONT)
                player.terminate()
                with suppress(subprocess.TimeoutExpired):
                    player.wait(10.0)
                player.kill()


@contextmanager
def virtual_run(folder: Path, clock: str = "wall", cycles: int = 5) -> Iterator[Forked]:
    """`eldir rig drive` on a virtual rig, without robot and camera."""
    rig = folder / "virtual.yaml"
    text = rig_text(clock=clock).replace("virtual bench", f"bench of {folder.name}")
    rig.write_text("\n".join(line for line in text.splitlines() if not line.startswith("camera")))
    save_schedule(rig, folder / "schedule.json", cycles)
    words = [str(folder / "schedule.json"), "--rig", str(rig), "--log", str(folder / "virtual.mcap")]
    with Forked(
        [*ELDIR, "rig", "drive", *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    ) as player:
        try:
            yield player
        finally:
            player.terminate()
            with suppress(subprocess.TimeoutExpired):
                player.wait(10.0)
            player.kill()


def post(host: str, path: str, token: str | None = None, origin: str | None = None):
    """Status and answer of a POST, such as a stop from another browser. `host` as in the page's address."""
    line = http.client.HTTPConnection(host, timeout=30)
    headers = {"Origin": origin or f"http://{host}"}
    if token is not None:
        headers["Authorization"] = f"Bearer {token}"
    line.request("POST", path, headers=headers)
    answer = line.getresponse()
    body = answer.read()
    line.close()
    return answer.status, json.loads(body) if body.startswith(b"{") else body


def free_port() -> int:
    """A port at which nothing listens now."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


@contextmanager
def watching(*words: object, port: int = 0) -> Iterator[tuple[str, Forked]]:
    """`eldir rig watch`; its address, and its process."""
    listen = () if "--listen" in words else ("--listen", f"127.0.0.1:{port}")
    command = [*ELDIR, "rig", "watch", *map(str, words), *listen]
    with Forked(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as server:
        try:
            said = server.stdout.readline().strip()
            if said.startswith("Foxglove"):
                server.told, said = said, server.stdout.readline().strip()
            assert said.startswith("http://"), said + server.stdout.read()
            yield said, server
        finally:
            server.terminate()
            with suppress(subprocess.TimeoutExpired):
                server.wait(5.0)
            server.kill()
