"""Starts the process that sends the words of a run."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from eldir_app.notify.delivery import INSTALL, LONGEST, is_installed
from eldir_hardware.rig.configuration import Rig

_logger = logging.getLogger(__name__)
_ENDING = LONGEST + 5.0  # [s]


@contextmanager
def notifications(rig: Rig, log: Path) -> Iterator[None]:
    """A run inside this context is followed by that process, if the rig file has addresses.

    Whatever happens to the process, the run goes on. After the run, when everything is off, the context
    waits for it, for a bounded time.
    """
    sender = None
    if rig.notify and not is_installed():
        _logger.warning("no word will be sent: apprise is not installed: %s", INSTALL)
    elif rig.notify:
        try:
            sender = _start(rig, log)
        except OSError as error:
            _logger.warning("no word will be sent: %s", error.strerror)
    try:
        yield
    finally:
        if sender is not None and sender.stdin is not None:
            with suppress(OSError):
                sender.stdin.close()
            with suppress(subprocess.TimeoutExpired):
                sender.wait(_ENDING)
            sender.kill()


def _start(rig: Rig, log: Path) -> subprocess.Popen[bytes]:
    sender = subprocess.Popen(
        [sys.executable, "-m", "eldir_app.notify.sender"],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C ends the run, whose end is a word
    )
    told = {
        "log": str(log.absolute()),
        "rig": rig.name,
        "port": rig.board.port if rig.kind == "real" else None,
        "camera": rig.camera is not None,
        "addresses": [address.get_secret_value() for address in rig.notify],
    }
    assert sender.stdin is not None
    with suppress(BrokenPipeError):
        sender.stdin.write(json.dumps(told).encode() + b"\n")
        sender.stdin.flush()
    return sender
