"""Base of the emulated relay boards: a pseudo-terminal, wire times, contacts, and their faults."""

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

from eldir_hardware._serial_output import log_frame
from eldir_hardware.clock import Clock, WallClock
from eldir_hardware.realtime import EMULATED_HARDWARE, request_realtime_priority

_logger = logging.getLogger(__name__)

CONTACT_TIME = 0.010
"""Time from switching a coil until its contact moves [s]."""


class ContactEvent(NamedTuple):
    """A contact that closed or opened."""

    t: float
    """Time on the board's clock [s]."""
    channel: int
    closed: bool
    power: float = 1.0
    """Part of the time for which it conducts: between 0 and 1 if modulated, 0 if open."""


@dataclass
class Faults:
    """Faults of a board; they can be changed at any time."""

    welded: set[int] = field(default_factory=set)
    """Contacts that never open again once closed; the board nevertheless reports them open."""
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

    def __init__(
        self, channels: int, clock: Clock, on_contact_event: Callable[[ContactEvent], None] | None = None
    ):
        self.channels = channels
        self.faults = Faults()
        self.contact_events: list[ContactEvent] = []
        """Every movement of a contact since the start, in order of time."""
        self.port = ""
        self._clock = clock.follower()
        self._on_contact_event = on_contact_event
        self.coils = [False] * channels
        """Commanded states, as the board reports them, channel 1 first."""
        self._contacts = [False] * channels
        self._conducted = [0.0] * channels
        self._wire_free_at = clock.now()
        self._bytes_received = 0
        self._bytes_arrived = threading.Condition()
        self._lock = threading.Lock()
        self._threads: list[threading.Thread] = []

    @property
    def contacts(self) -> tuple[bool, ...]:
        """Whether each contact is closed, channel 1 first."""
        return tuple(self._contacts)

    def start(self) -> str:
        """Open the pseudo-terminal, serve it, and return its port."""
        self._board_end, self.client_end = os.openpty()
        tty.setraw(self._board_end)
        tty.setraw(self.client_end)  # kept open, so that clients can close and reopen it
        self.port = os.ttyname(self.client_end)
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
        for handle in (self._board_end, self.client_end, self._stop_read, self._stop_write):
            os.close(handle)

    def reset(self) -> None:
        """Restart the board, as after a dip of its supply: every relay opens."""
        for channel in range(1, self.channels + 1):
            self.set_coil(channel, False, self._clock.now())

    def unplug(self) -> None:
        """Pull the cable: the port vanishes, and without power every relay opens."""
        self.close()
        self.reset()

    def wait_for_bytes(self, total: int) -> None:
        """Wait until `total` bytes have been processed, for at most five seconds of real time."""
        with self._bytes_arrived:
            self._bytes_arrived.wait_for(lambda: self._bytes_received >= total or not self._threads, 5.0)

    def _serve(self) -> None:
        if isinstance(self._clock, WallClock):
            request_realtime_priority(EMULATED_HARDWARE)
        pending = b""
        while True:
            ready, _, _ = select([self._board_end, self._stop_read], [], [])
            if self._stop_read in ready:
                return
            chunk = os.read(self._board_end, 4096)
            log_frame(_logger, "received at", self.port, chunk)
            pending = self._serve_requests(pending + chunk)
            with self._bytes_arrived:
                self._bytes_received += len(chunk)
                self._bytes_arrived.notify_all()

    def _serve_requests(self, data: bytes) -> bytes:
        """Obey every complete request, each after its time on the wire; return the remaining bytes."""
        while length := self.request_length(data):
            self._wait_wire_time(length)
            answer = self.obey(data[:length])
            data = data[length:]
            if answer and not self.faults.silent:
                if self.faults.garbled:
                    answer = bytes(b ^ 0x20 for b in answer)
                self._wait_wire_time(len(answer))
                self.send_answer(answer)
        return data

    def send_answer(self, answer: bytes) -> None:
        """Send an answer, delayed by `faults.late`."""
        if self.faults.late:
            self._clock.call_at(self._clock.now() + self.faults.late, lambda _: self.deliver(answer))
        else:
            self.deliver(answer)

    def deliver(self, answer: bytes) -> None:
        """Write an answer to the port at once."""
        if self._threads:  # still plugged in
            os.write(self._board_end, answer)
            log_frame(_logger, "answered at", self.port, answer)

    def _wait_wire_time(self, count: int) -> None:
        """Wait for the wire time of `count` bytes; a pseudo-terminal has no baud rate."""
        self._wire_free_at = max(self._wire_free_at, self._clock.now()) + count * 10 / self.baud
        self._clock.sleep_until(self._wire_free_at)

    def set_coil(self, channel: int, on: bool, t: float | None = None) -> None:
        """Switch one relay at `t`, or after the last byte on the wire; its contact moves later."""
        with self._lock:  # timers have their own thread
            self._move_contact(channel, on, self._wire_free_at if t is None else t)

    def _move_contact(self, channel: int, on: bool, t: float) -> None:
        if not 1 <= channel <= self.channels or channel in self.faults.deaf:
            return
        i = channel - 1
        self.coils[i] = on
        welded = channel in self.faults.welded and self._contacts[i]
        power = 1.0 if welded else self._power(channel) if on else 0.0
        if power == self._conducted[i]:
            return
        self._conducted[i] = power
        self._contacts[i] = power > 0
        event = ContactEvent(t + self.contact_time, channel, power > 0, power)
        self.contact_events.append(event)
        if self._on_contact_event is not None:
            self._on_contact_event(event)

    def _power(self, channel: int) -> float:
        """Part of the time for which a channel conducts while it is on."""
        return 1.0

    @abstractmethod
    def request_length(self, data: bytes) -> int:
        """Length of the first request (or noise) in `data`; 0 if it is incomplete."""

    @abstractmethod
    def obey(self, request: bytes) -> bytes:
        """Obey the request, and return the answer."""
