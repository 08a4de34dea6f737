"""`eldir rig watch`: opens the socket, decides whether a token is needed, and serves the page."""

from __future__ import annotations

import ipaddress
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from eldir.core.arguments import require_value
from eldir.errors import InputError, MissingDependencyError
from eldir_app.watch.rig_control import EmergencyStop, ScheduleStart, load
from eldir_hardware.rig._board_hints import read_board_hints

PORT = 8642


@dataclass(frozen=True)
class WatchConfig:
    """What the page shows, where it is served, and what it may do."""

    rig_file: Path | None = None
    log: Path | None = None
    address: str = f"127.0.0.1:{PORT}"
    """HOST:PORT to listen at."""
    host_names: tuple[str, ...] = ()
    """Names of this computer in browsers, besides its own."""
    stop_without_token: bool = False
    schedule: Path | None = None
    """Schedule that the page may start."""
    foxglove_port: int | None = None
    """Port of the live connection for Foxglove."""

    def check(self) -> None:
        """Raise `InputError` for options that contradict each other, or a rig file without a rig."""
        if self.schedule is not None and self.rig_file is None:
            raise InputError("--allow-start needs --rig", expected="the rig that the schedule is for")
        if self.rig_file is not None and self.log is not None:
            raise InputError("give --rig or --log, not both", expected="a rig to watch, or one log")
        if self.rig_file is not None:
            hints = read_board_hints(self.rig_file)  # a damaged file may still name the port to stop
            if hints.problem or not (hints.ports or hints.virtual):
                problem = hints.problem or "no port"
                raise InputError(
                    f"{self.rig_file} does not describe a rig",
                    expected="a rig file with its port",
                    found=problem,
                )


def serve_page(config: WatchConfig, say: Callable[[str], None]) -> None:
    """Serve the page until Ctrl-C. `say` prints its address. Raises `EldirError` for an invalid address, rig
    file, log or schedule."""
    config.check()
    with (
        _listen(config.address) as listening,
        load() as loaded_stop,  # loads while the rest is imported here
        _foxglove_server(config.foxglove_port, say) as on_log,
    ):
        from eldir_app.watch.access import Access, load_token
        from eldir_app.watch.followed_run import FollowedRun

        serve = _import_server()
        run = FollowedRun(config.rig_file, config.log, on_log)
        start = None
        if config.rig_file is not None and config.schedule is not None:
            start = ScheduleStart(config.rig_file, config.schedule)
        host, port = listening.getsockname()[:2]
        is_local = ipaddress.ip_address(host).is_loopback
        token = load_token() if start is not None or not is_local else None
        access = Access(token, frozenset(config.host_names), config.stop_without_token, is_local)
        stop = EmergencyStop(run.stop_arguments, run.virtual_runs, loaded_stop)
        serve(run, access, stop, start, listening, lambda: _print_address(host, port, token, say))


def _import_server() -> Callable[..., None]:
    """The function `serve`. Raises `MissingDependencyError` without the extra `watch`."""
    try:
        from eldir_app.watch.server import serve
    except ModuleNotFoundError as error:
        if error.name not in ("starlette", "uvicorn", "websockets"):
            raise
        raise MissingDependencyError(
            f"eldir rig watch needs {error.name}", remedy="install it: pip install 'eldir[watch]'"
        ) from None
    return serve


def _print_address(host: str, port: int, token: str | None, say: Callable[[str], None]) -> None:
    """Print the address of the page; the token only on a terminal."""
    name = f"[{host}]" if ":" in host else host
    if ipaddress.ip_address(host).is_unspecified:
        name = socket.gethostname()
    shows_token = token is not None and sys.stdout.isatty()
    say(f"http://{name}:{port}/{f'#{token}' if shows_token else ''}")
    if token is not None and not shows_token:
        say("the token is in the file .watch-token, in the folder of the latched stops")


@contextmanager
def _foxglove_server(port: int | None, say: Callable[[str], None]) -> Iterator[Callable[[Path], None]]:
    """The process that serves Foxglove; the function that is yielded sends it the log to follow. The page
    does not depend on it."""
    if port is None:
        yield lambda log: None
        return
    if find_spec("foxglove") is None:
        raise MissingDependencyError(
            "--foxglove needs foxglove-sdk", remedy="install it: pip install 'eldir[foxglove]'"
        )
    command = [sys.executable, "-m", "eldir_app.watch.foxglove_server", str(port)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, text=True, start_new_session=True, **pipes) as process:  # type: ignore[call-overload]
        try:
            if not (opened := process.stdout.readline().strip()):
                raise InputError(
                    f"cannot listen at port {port} for Foxglove",
                    code="watch.not-listening",
                    remedy="choose another port",
                )
            say(f"Foxglove: open a connection to ws://127.0.0.1:{opened}")

            def on_log(log: Path) -> None:
                with suppress(OSError):
                    process.stdin.write(f"{log}\n")
                    process.stdin.flush()

            yield on_log
        finally:
            process.kill()


def _listen(address: str) -> socket.socket:
    """A socket that listens at HOST:PORT, where HOST is an IP address; port 0 means any free one."""
    host, _, text = address.rpartition(":")
    family = None
    with suppress(ValueError):
        version = ipaddress.ip_address(host.strip("[]")).version
        family = socket.AF_INET6 if version == 6 else socket.AF_INET
    is_valid = family is not None and text.isascii() and text.isdigit() and int(text) < 65536
    require_value("--listen", is_valid, f"an address and a port, such as 127.0.0.1:{PORT}", address)
    assert family is not None
    listening = socket.socket(family, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((host.strip("[]"), int(text)))
        listening.listen(128)
    except OSError as error:
        listening.close()
        raise InputError(
            f"cannot listen at {address}: {error.strerror}",
            code="watch.not-listening",
            remedy="choose another port with --listen",
        ) from None
    return listening
