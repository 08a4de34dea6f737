"""Notifications of a run by mail or chat (apprise): run finished or stopped, stop latched, camera lost.

A separate process reads the log and sends them, so that no heating waits for the network.
"""

from __future__ import annotations

import importlib.util
import json
import logging
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from eldir_hardware.rig.addresses import describe_address

if TYPE_CHECKING:
    from eldir_hardware.rig.configuration import Rig

DELIVERY_TIMEOUT_S = 10.0
"""An address that does not answer for so long is given up."""
INSTALL = "pip install 'eldir[notify]'"
_SENDER_TIMEOUT_S = DELIVERY_TIMEOUT_S + 5.0
_logger = logging.getLogger(__name__)


@contextmanager
def notifications(rig: Rig, log: Path) -> Iterator[None]:
    """Send notifications of the run inside this context to the addresses of the rig file.

    The run goes on whatever happens to the sending process. After the run, when everything is off, the
    context waits for that process, at most `_SENDER_TIMEOUT_S`.
    """
    sender = None
    if rig.notify and not is_installed():
        _logger.warning("notifications are not sent: apprise is not installed: %s", INSTALL)
    elif rig.notify:
        try:
            sender = _start_sender(rig, log)
        except OSError as error:
            _logger.warning("notifications are not sent: %s", error.strerror)
    try:
        yield
    finally:
        if sender is not None and sender.stdin is not None:
            with suppress(OSError):
                sender.stdin.close()
            with suppress(subprocess.TimeoutExpired):
                sender.wait(_SENDER_TIMEOUT_S)
            sender.kill()


def is_installed() -> bool:
    """Whether apprise, which sends notifications, is installed."""
    return importlib.util.find_spec("apprise") is not None


class Delivery:
    """Sends one notification; each address has a thread, so that none waits for another."""

    def __init__(self, addresses: Sequence[str], title: str, text: str):
        self._problems: dict[int, str] = {}
        self._names = [describe_address(n, address) for n, address in enumerate(addresses, start=1)]
        self._threads = [
            threading.Thread(target=self._send, args=[n, address, title, text], daemon=True)
            for n, address in enumerate(addresses)
        ]
        for thread in self._threads:
            thread.start()

    def failures(self, timeout_s: float = DELIVERY_TIMEOUT_S) -> dict[str, str]:
        """What went wrong, by the name of the address. Waits for all answers together at most `timeout_s`."""
        failures = {}
        for index, (name, thread) in enumerate(zip(self._names, self._threads, strict=True)):
            thread.join(timeout_s)
            if thread.is_alive():
                timeout_s = 0.0
                failures[name] = f"did not answer within {DELIVERY_TIMEOUT_S:g} s"
            elif index in self._problems:
                failures[name] = self._problems[index]
        return failures

    def _send(self, index: int, address: str, title: str, text: str) -> None:
        try:
            import apprise

            logging.getLogger("apprise").disabled = True  # its records contain hosts and tokens
            service = apprise.Apprise.instantiate(address)
            if service is None:
                self._problems[index] = "is unknown to apprise"
            elif not service.notify(body=text, title=title):
                self._problems[index] = "refused the notification"
        except Exception as error:  # a service may raise anything; its message may contain the address
            self._problems[index] = f"failed ({type(error).__name__})"


def _start_sender(rig: Rig, log: Path) -> subprocess.Popen[bytes]:
    sender = subprocess.Popen(
        [sys.executable, "-m", "eldir_app.notification_sender"],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C ends the run, and its end is still notified
    )
    job = {
        "log": str(log.absolute()),
        "rig": rig.name,
        "port": rig.board.port if rig.kind == "real" else None,
        "camera": rig.camera is not None,
        "addresses": [address.get_secret_value() for address in rig.notify],
    }
    assert sender.stdin is not None
    with suppress(BrokenPipeError):
        sender.stdin.write(json.dumps(job).encode() + b"\n")
        sender.stdin.flush()
    return sender
