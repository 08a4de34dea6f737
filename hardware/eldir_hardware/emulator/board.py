"""An emulated relay board: contacts that move a moment after the bytes, and that may misbehave."""

from __future__ import annotations

import logging
import os
import threading
import tty
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from select import select
from typing import NamedTuple

from eldir_hardware.clock import Clock
from eldir_hardware.serial_output import log_frame

_logger = logging.getLogger(__name__)

CONTACT_TIME = 0.010
"""A contact moves this long after its coil is switched [s]."""


class ContactEvent(NamedTuple):
    """A contact that closed or opened."""

    t: float
    """Time on the board's clock [s]."""
    channel: int
    closed: bool
    power: float = 1.0
    """Part of the time for which it conducts: less than 1 where the board modulates it, 0 where it is
    open."""


@dataclass
class Faults:
    """Faults of a board; they can be changed at any time."""

    welded: set[int] = field(default_factory=set)
    """Contacts that never open again once closed; the board does not know and reports them open."""
    deaf: set[int] = field(default_factory=set)
    """Channels that ignore commands; the report shows it."""
    silent: bool = False
    """Whether the board never answers."""
    garbled: bool = False
    """Whether every byte of an answer has a flipped bit."""
    late: float = 0.0
    """Delay of every answer [s]."""


class EmulatedBoard(ABC):
    """A board behind a pseudo-terminal, served by its own thread between `start` and `close`."""

    baud = 9600
    contact_time = CONTACT_TIME

    def __init__(self, channels: int, clock: Clock, on_edge: Callable[[ContactEvent], None] | None = None):
        self.channels = channels
        self.faults = Faults()
        self.edges: list[ContactEvent] = []
        self.port = ""
        self._clock = clock.follower()
        self._on_edge = on_edge
        self._coils = [False] * channels
        self._contacts = [False] * channels
        self._conducted = [0.0] * channels
        self._wire_free_at = clock.now()
        self._bytes_received = 0
        self._arrival = threading.Condition()
        self._switching = threading.Lock()
        self._threads: list[threading.Thread] = []

    @property
    def contacts(self) -> tuple[bool, ...]:
        """Whether each contact is closed, channel 1 first."""
        return tuple(self._contacts)

    def start(self) -> str:
        """Open the pseudo-terminal, serve it, and return its port."""
        self._host, self._guest = os.openpty()
        tty.setraw(self._host)
        tty.setraw(self._guest)  # held open, so that clients may come and go
        self.port = os.ttyname(self._guest)
        self._stop_read, self._stop_write = os.pipe()
        thread = threading.Thread(target=self._serve, name="emulated board", daemon=True)
        self._threads.append(thread)
        thread.start()
        return self.port

    def close(self) -> None:
        """Stop serving; the contacts stay as they are."""
        if not self._threads:
            return
        os.write(self._stop_write, b".")
        self._threads.pop().join()
        for handle in (self._host, self._guest, self._stop_read, self._stop_write):
            os.close(handle)

    def reset(self) -> None:
        """The board restarts, as after a dip of its supply: every relay opens."""
        for channel in range(1, self.channels + 1):
            self._set_coil(channel, False, self._clock.now())

    def unplug(self) -> None:
        """The cable is pulled: the port is gone, and without power every relay opens."""
        self.close()
        self.reset()

    def wait_for_bytes(self, total: int) -> None:
        """Wait until `total` bytes have been processed, or for five seconds of real time."""
        with self._arrival:
            self._arrival.wait_for(lambda: self._bytes_received >= total or not self._threads, 5.0)

    def _serve(self) -> None:
        pending = b""
        while True:
            ready, _, _ = select([self._host, self._stop_read], [], [])
            if self._stop_read in ready:
                return
            chunk = os.read(self._host, 4096)
            log_frame(_logger, "received at", self.port, chunk)
            pending = self._serve_requests(pending + chunk)
            with self._arrival:
                self._bytes_received += len(chunk)
                self._arrival.notify_all()

    def _serve_requests(self, data: bytes) -> bytes:
        """Obey every complete request, each after its time on the wire; return the remaining bytes."""
        while length := self._request_length(data):
            self._spend(length)
            answer = self._obey(data[:length])
            data = data[length:]
            if answer and not self.faults.silent:
                if self.faults.garbled:
                    answer = bytes(b ^ 0x20 for b in answer)
                self._spend(len(answer))
                self._answer(answer)
        return data

    def _answer(self, answer: bytes) -> None:
        if self.faults.late:
            self._clock.at(self._clock.now() + self.faults.late, lambda _: self._deliver(answer))
        else:
            self._deliver(answer)

    def _deliver(self, answer: bytes) -> None:
        if self._threads:  # not unplugged meanwhile
            os.write(self._host, answer)
            log_frame(_logger, "answered at", self.port, answer)

    def _spend(self, count: int) -> None:
        """Wait for the wire time of `count` bytes, because a pseudo-terminal has no baud rate."""
        self._wire_free_at = max(self._wire_free_at, self._clock.now()) + count * 10 / self.baud
        self._clock.sleep_until(self._wire_free_at)

    def _set_coil(self, channel: int, on: bool, t: float | None = None) -> None:
        """Switch one relay at `t`, or when the wire falls silent; its contact follows."""
        with self._switching:  # timers have their own thread
            self._move(channel, on, self._wire_free_at if t is None else t)

    def _move(self, channel: int, on: bool, t: float) -> None:
        if not 1 <= channel <= self.channels or channel in self.faults.deaf:
            return
        i = channel - 1
        self._coils[i] = on
        welded = channel in self.faults.welded and self._contacts[i]
        power = 1.0 if welded else self._power(channel) if on else 0.0
        if power == self._conducted[i]:
            return
        self._conducted[i] = power
        self._contacts[i] = power > 0
        edge = ContactEvent(t + self.contact_time, channel, power > 0, power)
        self.edges.append(edge)
        if self._on_edge is not None:
            self._on_edge(edge)

    def _power(self, channel: int) -> float:
        """Part of the time for which a channel conducts while it is on."""
        return 1.0

    @abstractmethod
    def _request_length(self, data: bytes) -> int:
        """Bytes of the first request (or of noise to skip) in `data`; 0 if it is not complete yet."""

    @abstractmethod
    def _obey(self, request: bytes) -> bytes:
        """Switch as the request says, and return the answer."""
