"""Switch a board off, whoever drives it: the frames first, then the end of that program, then the proof."""

from __future__ import annotations

import errno
import logging
import os
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from eldir.errors import EldirError, InputError
from eldir_hardware.clock import WallClock
from eldir_hardware.relay.board import RelayBoard
from eldir_hardware.relay.errors import BlockedPortError, PortError, RelayError
from eldir_hardware.relay.off_frames import off_bursts
from eldir_hardware.relay.registration import board_of, kinds
from eldir_hardware.rig.board_identity import Port, locate, open_device
from eldir_hardware.rig.port_holder import holder_of
from eldir_hardware.safety.holder_stopper import POLL, WAIT, HolderStopper
from eldir_hardware.safety.latch import boottime, latch, record_of
from eldir_hardware.safety.off_targets import Target
from eldir_hardware.safety.state_folder import SHARED, StateError
from eldir_hardware.safety.unlocked_port import UnlockedPort
from eldir_hardware.serial_output import BITS_A_BYTE, BlockedOutputError

_logger = logging.getLogger(__name__)

REASON = "stopped by eldir rig off"


@dataclass
class Outcome:
    """What became of one port."""

    port: str
    proven: bool
    text: str
    channels: int | None = None
    """Channels that the board's report covers."""


def switch_off(target: Target, shared: Path = SHARED) -> Outcome:
    """Open every contact of a device, prove it by its own report, and latch the stop."""
    begun, device = boottime(), target.device
    stopper = HolderStopper(device)
    with suppress(OSError):
        stopper.ask(may_kill=False)
    try:
        port = UnlockedPort(device)
    except OSError as error:
        return _unreachable(target, error, shared)
    try:
        candidates = _candidates(target)
        bursts = off_bursts(candidates)

        def send() -> bool:
            """Whether the port took the frames; the proof finds that it did not."""
            try:
                for frames, baud in bursts:
                    port.send(frames, baud, stopper.holder is not None)
            except BlockedOutputError:
                return False
            return True

        taken = send()
        _logger.info("sent the frames of all-off to %s", target.port)
        clock, sent_at = WallClock(), time.monotonic()
        unlatched = latch(target.device, REASON, shared=shared)
        stopper.wait(port, send)
        if not stopper.done:
            return Outcome(target.port, False, f"{stopper.text}its report cannot be asked for")
        if taken and any(channels is None for _, channels in candidates):
            # Sizes are tried once each: nothing may still be on the wire then.
            clock.sleep_until(sent_at + sum(2 * len(frames) * BITS_A_BYTE / baud for frames, baud in bursts))
        outcome = _prove(target, candidates, begun, stopper, shared)
    except EldirError as error:
        return Outcome(target.port, False, str(error))
    finally:
        port.close()
    if outcome.proven:
        unlatched = latch(target.device, REASON, opened=True, shared=shared)
    if unlatched:
        outcome.proven = False
        outcome.text += f"; the stop is not latched: {unlatched}"
    _logger.info("%s: %s", target.port, outcome.text)
    return outcome


def _candidates(target: Target) -> list[tuple[str, int | None]]:
    """What the board may be. Without a hint: every kind that can be loaded."""
    if target.candidates:
        return target.candidates
    candidates: list[tuple[str, int | None]] = []
    for kind in kinds():
        with suppress(InputError):
            board_of(kind)
            candidates.append((kind, None))
    return candidates


def _unreachable(target: Target, error: OSError, shared: Path) -> Outcome:
    """The port cannot be opened."""
    record = target.record
    if record is not None and record.opened is not None and error.errno in (errno.ENOENT, errno.ENXIO):
        text = "is not connected; all its contacts were open by the board's report when "
        if os.path.lexists(shared):
            return Outcome(target.port, True, f"{text}it was last driven", record.channels)
        text += "you last stopped it, and runs of other users are recorded elsewhere"
        return Outcome(target.port, False, text, record.channels)
    if record is not None:
        latch(target.device, REASON, shared=shared)
    return Outcome(target.port, False, f"cannot be opened: {error.strerror}")


def _prove(
    target: Target,
    candidates: list[tuple[str, int | None]],
    begun: float,
    stopper: HolderStopper,
    shared: Path,
) -> Outcome:
    """The first kind of board whose report says that every contact is open.

    Of a port that has gone, as that of a virtual rig goes with its program, the report counts that its
    guardian saw after it was asked to end.
    """
    problem = ""
    for kind, channels in candidates:
        sizes = [channels] if channels else _counts(board_of(kind).most_channels)
        for place, count in enumerate(sizes):
            try:
                ended_well = not stopper.killed and _guardian_proved(target, begun, shared)
                _prove_open(kind, target.device, count, ended_well, sized=channels is not None)
            except BlockedPortError as error:  # whatever board it is
                return Outcome(target.port, False, f"{stopper.text}{error}")
            except RelayError as error:
                problem = problem or str(error)
                continue
            proven = _largest(kind, target.device, sizes[: place + 1])
            text = f"{stopper.text}all {proven} channels are open by the board's report"
            return Outcome(target.port, True, text, proven)
    if not stopper.killed and not _is_there(target) and _guardian_proved(target, begun, shared):
        text = f"{stopper.text}all contacts were open by the board's report; then the port went away"
        return Outcome(target.port, True, text)
    return Outcome(target.port, False, f"{stopper.text}{problem}")


def _prove_open(kind: str, port: Port, count: int, ended_well: bool, *, sized: bool) -> None:
    """Open every contact of a board of this size, and prove it. Raises `RelayError`.

    `ended_well`: its guardian has done so. `sized`: the size is known; otherwise the board is asked first, as
    one of another size answers incompletely.
    """
    board = _open(kind, port, count)
    try:
        if not sized:
            board.states(attempts=1)
        if not (ended_well and board.reports_all_open()):
            board.all_off()
    finally:
        board.close()


def _largest(kind: str, port: Port, sizes: list[int]) -> int:
    """The largest size that is proven open. The last one was; on a busy computer the answer of a larger one
    may have been too late."""
    proven = sizes[-1]
    for count in reversed(sizes[:-1]):
        try:
            _prove_open(kind, port, count, False, sized=False)
        except RelayError:
            break
        proven = count
    return proven


def _open(kind: str, port: Port, channels: int) -> RelayBoard:
    """The board. The program whose guardian was killed may hold the port for a moment."""
    deadline = time.monotonic() + WAIT
    while True:
        try:
            return open_device(port, lambda at: board_of(kind).driver(at, channels, WallClock()), PortError)
        except RelayError:
            if time.monotonic() > deadline or holder_of(port) is None:
                raise
            time.sleep(POLL)


def _counts(most: int) -> list[int]:
    """Numbers of channels to try, the largest first: only the true one answers completely."""
    return [most, *(n for n in (16, 8, 4, 2, 1) if n < most)]


def _is_there(target: Target) -> bool:
    where = locate(target.device)
    return where is not None and os.path.exists(where)


def _guardian_proved(target: Target, begun: float, shared: Path) -> bool:
    """Whether the guardian proved everything off after it was asked to, and then ended by itself."""
    before = None if target.record is None else target.record.opened
    with suppress(StateError):
        record = record_of(target.device, shared)
        opened = None if record is None else record.opened
        return opened is not None and opened != before and begun <= opened <= boottime()
    return False
