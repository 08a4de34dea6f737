"""Delivers a word through apprise, to all addresses at once and in bounded time."""

from __future__ import annotations

import importlib.util
import logging
import threading
from collections.abc import Sequence

from eldir_hardware.rig.addresses import name_of

LONGEST = 10.0
"""An address that has not answered for so long is given up [s]."""
INSTALL = "pip install 'eldir[notify]'"


def is_installed() -> bool:
    """Whether a word can be sent at all."""
    return importlib.util.find_spec("apprise") is not None


class Delivery:
    """One word on its way; each address has a thread, so that none waits for another."""

    def __init__(self, addresses: Sequence[str], title: str, text: str):
        self._problems: dict[int, str] = {}
        self._names = [name_of(n, address) for n, address in enumerate(addresses, start=1)]
        self._threads = [
            threading.Thread(target=self._send, args=[n, address, title, text], daemon=True)
            for n, address in enumerate(addresses)
        ]
        for thread in self._threads:
            thread.start()

    def failures(self, seconds: float = LONGEST) -> dict[str, str]:
        """What went wrong, by the name of the address; waits for answers for at most so long [s]."""
        found = {}
        for number, (name, thread) in enumerate(zip(self._names, self._threads, strict=True)):
            thread.join(seconds)
            if thread.is_alive():
                seconds = 0.0
                found[name] = f"did not answer within {LONGEST:g} s"
            elif number in self._problems:
                found[name] = self._problems[number]
        return found

    def _send(self, number: int, address: str, title: str, text: str) -> None:
        try:
            import apprise

            logging.getLogger("apprise").disabled = True  # it names hosts and tokens
            service = apprise.Apprise.instantiate(address)
            if service is None:
                self._problems[number] = "is no address that apprise knows"
            elif not service.notify(body=text, title=title):
                self._problems[number] = "did not take it"
        except Exception as error:  # a service may raise anything; its text may hold the address
            self._problems[number] = f"failed ({type(error).__name__})"
