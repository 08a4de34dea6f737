"""Switches a board off, whichever program drives it: the frames, the end of that program, the proof."""

from __future__ import annotations

import errno
import logging
import os
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from eldir.errors import EldirError, InputError
from eldir_hardware._serial_output import BITS_PER_BYTE, BlockedOutputError
from eldir_hardware.clock import WallClock
from eldir_hardware.relay.board import RelayBoard
from eldir_hardware.relay.errors import BlockedPortError, PortError, RelayError
from eldir_hardware.relay.registration import get_board, installed_kinds
from eldir_hardware.rig.board_identity import Port, locate, open_device
from eldir_hardware.rig.port_holder import Holder, find_holder, signal_holder
from eldir_hardware.safety.latch import find_record, latch, uptime
from eldir_hardware.safety.off_frames import UnlockedPort, off_bursts
from eldir_hardware.safety.off_targets import OffTarget
from eldir_hardware.safety.state_folder import SHARED_FOLDER, StateError

OFF_REASON = "stopped by eldir rig off"
_logger = logging.getLogger(__name__)
PORT_TIMEOUT = 1.5
"""Longest wait for a port, whatever holds it [s]."""
POLL_INTERVAL = 0.005
_PATIENCE = 0.4  # from SIGTERM to SIGKILL: a running guardian proves everything off in less time [s]
_RESEND_INTERVAL = 0.5  # from one sending of the frames to the next, longer than a guardian's proof [s]


@dataclass
class OffResult:
    """Result for one port."""

    port: str
    proven: bool
    report: str
    channels: int | None = None
    """Channels that the board's report covers."""


def switch_off(target: OffTarget, shared: Path = SHARED_FOLDER) -> OffResult:
    """Open every contact of a device, prove it by its own report, and latch the stop."""
    started_at, device = uptime(), target.device
    stopper = HolderStopper(device)
    with suppress(OSError):
        stopper.request_end(may_kill=False)
    try:
        port = UnlockedPort(device)
    except OSError as error:
        return _unreachable_result(target, error, shared)
    try:
        candidates = _get_candidates(target)
        bursts = off_bursts(candidates)

        def send() -> bool:
            """Send the frames, and return whether the port accepted them."""
            try:
                for frames, baud in bursts:
                    port.send(frames, baud, stopper.holder is not None)
            except BlockedOutputError:
                return False
            return True

        was_accepted = send()
        _logger.info("sent the frames of all-off to %s", target.port)
        clock, sent_at = WallClock(), time.monotonic()
        latch_problem = latch(target.device, OFF_REASON, shared=shared)
        stopper.wait_until_port_is_free(port, send)
        if not stopper.is_free:
            return OffResult(target.port, False, f"{stopper.report}its report cannot be read")
        if was_accepted and any(channels is None for _, channels in candidates):
            # Each size is tried only once: no other bytes may be on the wire then.
            clock.sleep_until(
                sent_at + sum(2 * len(frames) * BITS_PER_BYTE / baud for frames, baud in bursts)
            )
        outcome = _prove(target, candidates, started_at, stopper, shared)
    except EldirError as error:
        return OffResult(target.port, False, str(error))
    finally:
        port.close()
    if outcome.proven:
        latch_problem = latch(target.device, OFF_REASON, opened=True, shared=shared)
    if latch_problem:
        outcome.proven = False
        outcome.report += f"; the stop is not latched: {latch_problem}"
    _logger.info("%s: %s", target.port, outcome.report)
    return outcome


def _get_candidates(target: OffTarget) -> list[tuple[str, int | None]]:
    """The possible kinds of board; all that can be loaded if nothing is known."""
    if target.candidates:
        return target.candidates
    candidates: list[tuple[str, int | None]] = []
    for kind in installed_kinds():
        with suppress(InputError):
            get_board(kind)
            candidates.append((kind, None))
    return candidates


def _unreachable_result(target: OffTarget, error: OSError, shared: Path) -> OffResult:
    """The result for a port that cannot be opened."""
    record = target.record
    if record is not None and record.opened is not None and error.errno in (errno.ENOENT, errno.ENXIO):
        report = "is not connected; all its contacts were open by the board's report when "
        if os.path.lexists(shared):
            return OffResult(target.port, True, f"{report}it was last driven", record.channels)
        report += "you last stopped it, and runs of other users are recorded elsewhere"
        return OffResult(target.port, False, report, record.channels)
    if record is not None:
        latch(target.device, OFF_REASON, shared=shared)
    return OffResult(target.port, False, f"cannot be opened: {error.strerror}")


def _prove(
    target: OffTarget,
    candidates: list[tuple[str, int | None]],
    started_at: float,
    stopper: HolderStopper,
    shared: Path,
) -> OffResult:
    """Prove every contact open, with the first kind of board whose report is valid.

    For a port that has vanished, as that of a virtual rig with its program, the proof of its guardian counts.
    """
    problem = ""
    for kind, channels in candidates:
        sizes = [channels] if channels else _sizes_to_try(get_board(kind).max_channels)
        for place, count in enumerate(sizes):
            try:
                guardian_proved = not stopper.has_killed and _guardian_proved(target, started_at, shared)
                _prove_open(kind, target.device, count, guardian_proved, size_known=channels is not None)
            except BlockedPortError as error:  # for every kind of board
                return OffResult(target.port, False, f"{stopper.report}{error}")
            except RelayError as error:
                problem = problem or str(error)
                continue
            proven = _largest_proven(kind, target.device, sizes[: place + 1])
            report = f"{stopper.report}all {proven} channels are open by the board's report"
            return OffResult(target.port, True, report, proven)
    if not stopper.has_killed and not _is_connected(target) and _guardian_proved(target, started_at, shared):
        report = f"{stopper.report}all contacts were open by the board's report; then the port went away"
        return OffResult(target.port, True, report)
    return OffResult(target.port, False, f"{stopper.report}{problem}")


def _prove_open(kind: str, port: Port, count: int, guardian_proved: bool, *, size_known: bool) -> None:
    """Open every contact of a board of this size, and prove it. Raises `RelayError`.

    `guardian_proved`: its guardian has proven it already. If the size is unknown, the states are read
    first, as a board of another size answers incompletely.
    """
    board = _open(kind, port, count)
    try:
        if not size_known:
            board.read_states(attempts=1)
        if not (guardian_proved and board.reports_all_open()):
            board.all_off()
    finally:
        board.close()


def _largest_proven(kind: str, port: Port, sizes: list[int]) -> int:
    """The largest size that is proven open: on a busy computer the answer of a larger one than the last may
    have been too late."""
    proven = sizes[-1]
    for count in reversed(sizes[:-1]):
        try:
            _prove_open(kind, port, count, False, size_known=False)
        except RelayError:
            break
        proven = count
    return proven


def _open(kind: str, port: Port, channels: int) -> RelayBoard:
    """Open the board; the program of a killed guardian may hold the port for a moment."""
    deadline = time.monotonic() + PORT_TIMEOUT
    while True:
        try:
            return open_device(port, lambda at: get_board(kind).driver(at, channels, WallClock()), PortError)
        except RelayError:
            if time.monotonic() > deadline or find_holder(port) is None:
                raise
            time.sleep(POLL_INTERVAL)


def _sizes_to_try(most: int) -> list[int]:
    """Numbers of channels to try, the largest first: only for the true one the answer is complete."""
    return [most, *(n for n in (16, 8, 4, 2, 1) if n < most)]


def _is_connected(target: OffTarget) -> bool:
    where = locate(target.device)
    return where is not None and os.path.exists(where)


def _guardian_proved(target: OffTarget, started_at: float, shared: Path) -> bool:
    """Whether the guardian has proven everything off since `started_at`."""
    before = None if target.record is None else target.record.opened
    with suppress(StateError):
        record = find_record(target.device, shared)
        opened = None if record is None else record.opened
        return opened is not None and opened != before and started_at <= opened <= uptime()
    return False


class HolderStopper:
    """Ends the program that holds the lock of a port."""

    def __init__(self, port: Port):
        self._port = port
        self._requested_at: dict[int, float] = {}
        self._killed_processes: set[int] = set()
        self.holder: Holder | None = None
        self.is_free = False
        self.report = ""

    @property
    def has_killed(self) -> bool:
        """Whether a program was killed, without a proof."""
        return bool(self._killed_processes)

    def request_end(self, may_kill: bool = True) -> None:
        """Send SIGTERM to the present holder, or SIGKILL if it does not react.

        Before a kill the stop must be latched, as the program whose guardian dies reads the cause there.
        """
        self.holder = holder = find_holder(self._port)
        if holder is None or holder.process in self._killed_processes:
            return
        now = time.monotonic()
        since = self._requested_at.get(holder.process)
        try:
            if since is None:
                self._requested_at[holder.process] = since = now
                if not signal_holder(self._port, holder.process, signal.SIGTERM):
                    raise PermissionError(errno.EPERM, "its open files cannot be read")
                self.report += f"stopped process {holder.process}; "
                _logger.info("sent SIGTERM to process %d, which holds %s", holder.process, self._port)
            if may_kill and (holder.suspended or now - since > _PATIENCE):
                self._killed_processes.add(holder.process)
                if signal_holder(self._port, holder.process, signal.SIGKILL):
                    self.report += "it did not end and was killed; "
                    _logger.info("killed process %d", holder.process)
                else:  # it has just ended
                    self._killed_processes.remove(holder.process)
        except OSError as error:
            if find_holder(self._port) == holder:  # it has not just ended
                self._killed_processes.add(holder.process)
                owner = "" if holder.user is None else f" of user {holder.user}"
                self.report += f"process {holder.process}{owner} cannot be ended: {error.strerror}; "

    def wait_until_port_is_free(self, port: UnlockedPort, send: Callable[[], object]) -> None:
        """Wait until no program holds the port."""
        started_at = sent = time.monotonic()
        while time.monotonic() - started_at < PORT_TIMEOUT:
            if port.is_free():
                self.is_free = True
                return
            self.request_end()
            if time.monotonic() - sent > _RESEND_INTERVAL:
                send()
                sent = time.monotonic()
            time.sleep(POLL_INTERVAL)
        self.report += "another program still holds the port; "
