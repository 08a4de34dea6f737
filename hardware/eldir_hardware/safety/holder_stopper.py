"""The end of the program that holds a port, for `eldir rig off`."""

from __future__ import annotations

import errno
import logging
import signal
import time
from collections.abc import Callable

from eldir_hardware.rig.board_identity import Port
from eldir_hardware.rig.port_holder import Holder, holder_of, signal_holder
from eldir_hardware.safety.unlocked_port import UnlockedPort

_logger = logging.getLogger(__name__)

WAIT = 1.5
"""Longest wait for a port, whatever holds it [s]."""
POLL = 0.005
_PATIENCE = 0.4  # from SIGTERM to SIGKILL: a guardian that lives proves everything off in less [s]
_AGAIN = 0.5  # from one sending of the frames to the next: in the patience they would disturb that proof [s]


class HolderStopper:
    """Ends the program that holds a port."""

    def __init__(self, port: Port):
        self._port = port
        self._asked: dict[int, float] = {}
        self._killed: set[int] = set()
        self.holder: Holder | None = None
        self.done = False
        self.text = ""

    @property
    def killed(self) -> bool:
        """Whether a program was killed: it proved nothing."""
        return bool(self._killed)

    def ask(self, may_kill: bool = True) -> None:
        """Send SIGTERM to the present holder, or SIGKILL to one that does not react.

        Before a kill the stop must be latched, or the program whose guardian dies does not know the cause.
        """
        self.holder = holder = holder_of(self._port)
        if holder is None or holder.process in self._killed:
            return
        now = time.monotonic()
        since = self._asked.get(holder.process)
        try:
            if since is None:
                self._asked[holder.process] = since = now
                if not signal_holder(self._port, holder.process, signal.SIGTERM):
                    raise PermissionError(errno.EPERM, "its open files cannot be read")
                self.text += f"stopped process {holder.process}; "
                _logger.info("sent SIGTERM to process %d, which holds %s", holder.process, self._port)
            if may_kill and (holder.stopped or now - since > _PATIENCE):
                self._killed.add(holder.process)
                if signal_holder(self._port, holder.process, signal.SIGKILL):
                    self.text += "it did not end by itself and was killed; "
                    _logger.info("killed process %d", holder.process)
                else:  # it has just ended by itself
                    self._killed.remove(holder.process)
        except OSError as error:
            if holder_of(self._port) == holder:  # it has not just ended by itself
                self._killed.add(holder.process)
                owner = "" if holder.user is None else f" of user {holder.user}"
                self.text += f"process {holder.process}{owner} cannot be ended: {error.strerror}; "

    def wait(self, port: UnlockedPort, send: Callable[[], object]) -> None:
        """Wait until nobody holds the port."""
        begun = sent = time.monotonic()
        while time.monotonic() - begun < WAIT:
            if port.is_free():
                self.done = True
                return
            self.ask()
            if time.monotonic() - sent > _AGAIN:
                send()
                sent = time.monotonic()
            time.sleep(POLL)
        self.text += "another program holds the port; "
