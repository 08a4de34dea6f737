"""`eldir rig watch`: open the socket, decide whether a token is needed, and serve."""

from __future__ import annotations

import ipaddress
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path

from eldir.core.arguments import require_value
from eldir.errors import InputError, MissingDependencyError
from eldir_app.watch.stop import Stop, load
from eldir_hardware.rig.board_hints import read_board_hints

PORT = 8642


def watch(
    rig_file: Path | None,
    log: Path | None,
    listen: str,
    names: Sequence[str],
    free_stop: bool,
    schedule: Path | None,
    foxglove: int | None,
    say: Callable[[str], None],
) -> None:
    """Serve the page until Ctrl-C. `schedule`: what the page may start. `foxglove`: port of the
    live connection for Foxglove. Raises `EldirError` for a wrong
    address, rig file, log or schedule."""
    if schedule is not None and rig_file is None:
        raise InputError("--allow-start needs --rig", expected="the rig that the schedule is for")
    if rig_file is not None and log is not None:
        raise InputError("give --rig or --log, not both", expected="a rig to watch, or one log")
    if rig_file is not None:
        told = read_board_hints(rig_file)  # a broken file tells enough to stop its rig
        if told.problem or not (told.ports or told.virtual):
            found = told.problem or "no port"
            raise InputError(f"{rig_file} tells no rig", expected="a rig file with its port", found=found)
    with (
        _listening(listen) as opened,
        load() as waiting,
        _live(foxglove, say) as turned,
    ):  # while it loads, so does the rest
        from eldir_app.watch.access import Access, kept_token
        from eldir_app.watch.follow import Follow

        try:
            from eldir_app.watch.server import serve
        except ModuleNotFoundError as error:
            if error.name not in ("starlette", "uvicorn", "websockets"):
                raise
            raise MissingDependencyError(
                f"eldir rig watch needs {error.name}", remedy="install it: pip install 'eldir[watch]'"
            ) from None
        from eldir_app.watch.start import Start

        follow = Follow(rig_file, log, turned)
        start = None if rig_file is None or schedule is None else Start(rig_file, schedule)
        host, port = opened.getsockname()[:2]
        local = ipaddress.ip_address(host).is_loopback
        token = kept_token() if start is not None or not local else None

        def ready() -> None:
            anywhere = ipaddress.ip_address(host).is_unspecified
            name = socket.gethostname() if anywhere else f"[{host}]" if ":" in host else host
            secret = f"#{token}" if token is not None and sys.stdout.isatty() else ""
            say(f"http://{name}:{port}/{secret}")
            if token is not None and not secret:
                say("the token is in the file .watch-token, in the folder of the latched stops")

        access = Access(token, frozenset(names), free_stop, local)
        serve(follow, access, Stop(follow.stop_words, waiting), start, opened, ready)


@contextmanager
def _live(port: int | None, say: Callable[[str], None]) -> Iterator[Callable[[Path], None]]:
    """The process of the live connection; what is yielded tells it which log to follow. The page goes on
    without it."""
    if port is None:
        yield lambda log: None
        return
    if find_spec("foxglove") is None:
        raise MissingDependencyError(
            "--foxglove needs foxglove-sdk", remedy="install it: pip install 'eldir[foxglove]'"
        )
    words = [sys.executable, "-m", "eldir_app.watch.live_connection", str(port)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(words, text=True, start_new_session=True, **pipes) as process:  # type: ignore[call-overload]
        try:
            if not (found := process.stdout.readline().strip()):
                raise InputError(
                    f"cannot listen at port {port} for Foxglove",
                    code="watch.not-listening",
                    remedy="choose another port",
                )
            say(f"Foxglove: open a connection to ws://127.0.0.1:{found}")

            def turned(log: Path) -> None:
                with suppress(OSError):
                    process.stdin.write(f"{log}\n")
                    process.stdin.flush()

            yield turned
        finally:
            process.kill()


def _listening(address: str) -> socket.socket:
    """A socket at HOST:PORT, where HOST is an address and PORT may be 0: any that is free."""
    host, _, text = address.rpartition(":")
    family = None
    with suppress(ValueError):
        version = ipaddress.ip_address(host.strip("[]")).version
        family = socket.AF_INET6 if version == 6 else socket.AF_INET
    good = family is not None and text.isascii() and text.isdigit() and int(text) < 65536
    require_value("--listen", good, f"an address and a port, such as 127.0.0.1:{PORT}", address)
    assert family is not None
    opened = socket.socket(family, socket.SOCK_STREAM)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        opened.bind((host.strip("[]"), int(text)))
        opened.listen(128)
    except OSError as error:
        opened.close()
        raise InputError(
            f"cannot listen at {address}: {error.strerror}",
            code="watch.not-listening",
            remedy="choose another port with --listen",
        ) from None
    return opened
