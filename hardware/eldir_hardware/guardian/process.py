"""The guardian: a process of its own that alone owns the port of a relay board.

It heats only while heartbeats come, and switches everything off, proven by read-back, when they stop,
when its parent's end of the socket closes (also by SIGKILL), and on SIGTERM (`eldir rig off`).
Started by `eldir_hardware.guardian.client`, as `eldir_hardware.guardian.isolation` says.
"""

from __future__ import annotations

import gc
import logging
import os
import select
import signal
import socket
import sys
import time
from contextlib import suppress
from functools import partial
from typing import Any

from eldir.core import program_log
from eldir.errors import EldirError, print_line
from eldir_hardware.clock import EMULATED_PATIENCE, WallClock
from eldir_hardware.guardian.bank import Report, reason_of
from eldir_hardware.guardian.measured_heat import CurrentFlowsError
from eldir_hardware.guardian.pulse_controller import HeartbeatError, PulseController
from eldir_hardware.guardian.wire import Wire
from eldir_hardware.relay.errors import NotProvenOffError
from eldir_hardware.rig.board_identity import BoardIdentity, Port, identify_open, moved
from eldir_hardware.rig.boards import open_board
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.sensors import open_sensor
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.safety.latch import (
    end_driving,
    latch,
    latch_for_driving,
    require_unlatched,
    require_unstopped,
)
from eldir_hardware.safety.spring_memory import Springs, at_the_ceiling, remember, remembered
from eldir_hardware.safety.stop_signals import StoppedError

_logger = logging.getLogger(__name__)
_OPENING = 5.0  # for the parent's first message [s]


class OrphanedError(EldirError):
    """The program that heats has died."""

    code = "guardian.orphaned"


class _Session:
    """One parent, one board."""

    def __init__(
        self,
        wire: Wire,
        controller: PulseController,
        rig: Rig,
        port: Port,
        sensor: BoardIdentity | None = None,
    ):
        """`port`, `sensor`: the very devices, whatever their names stand for by now."""
        self._wire, self._controller, self._rig, self._port = wire, controller, rig, port
        self._sensor = sensor
        self._signals, write = os.pipe()
        os.set_blocking(write, False)
        signal.set_wakeup_fd(write, warn_on_full_buffer=False)
        for number in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, lambda *_: None)  # heard through the pipe, never in mid-command
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent's to decide
        controller.on_report = self._report

    def run(self) -> None:
        """Serve until the parent ends the session. Raises on any other end."""
        try:
            self._serve()
        except EldirError:
            # `eldir rig off` opens the contacts itself: what the board then reports is not the cause.
            if self._is_signalled():
                raise self._signalled() from None
            raise

    def refuse_signalled(self) -> None:
        """Raise `StoppedError` after a signal: `eldir rig off` opens the contacts, and none may close behind
        its frames."""
        if self._is_signalled():
            raise StoppedError("stopped by a signal")

    def _is_signalled(self) -> bool:
        return bool(select.select([self._signals], [], [], 0.0)[0])

    def _serve(self) -> None:
        while True:
            wait = self._controller.step() - time.monotonic()
            sources: list[Any] = [self._wire, self._signals]
            ready, _, _ = select.select(sources, [], [], min(max(wait, 0.0), 1.0))
            if self._signals in ready:
                raise self._signalled()
            if self._wire in ready:
                messages = self._wire.receive()
                if messages is None:
                    raise OrphanedError("the program that heats has died")
                self._controller.beat()
                for message in messages:
                    if message["do"] == "end":
                        self._controller.disarm()
                        if self._controller.armed_once:
                            _remember_springs(self._controller, self._rig, self._port)
                        return
                    self._obey(message)

    def _signalled(self) -> StoppedError:
        number = os.read(self._signals, 64)[0]
        return StoppedError(f"stopped by {signal.Signals(number).name}, such as `eldir rig off` sends")

    def _obey(self, message: dict[str, Any]) -> None:
        match message["do"]:
            case "arm":
                require_unlatched(self._port)
                board = self._rig.board
                self._controller.check_limits()  # a rig file that does not fit leaves no latch
                latch_for_driving(self._port, board.kind, board.channels, self._rig.name, sensor=self._sensor)
                self._arm()
                _logger.info("armed: everything is proven off")
                self._wire.send(**{"is": "armed", "rested_at": self._controller.rested_at})
            case "heat":
                _logger.debug("heat at %s for %s", message["at"], message["for"])
                try:
                    self._controller.heat(message["at"], {int(c): s for c, s in message["for"].items()})
                except LimitError as error:
                    self._wire.send(**{"is": "refused", "why": str(error), "code": error.code})
            case "abort_pulses":
                self._controller.abort_pulses()
            case "beat":
                self._wire.send(**{"is": "alive"})
            case "disarm":
                self._wire.send(**{"is": "opening"})
                self._controller.disarm()
                end_driving(self._port)
                _logger.info("disarmed: everything is proven off")
                self._wire.send(**{"is": "off"})
                _remember_springs(self._controller, self._rig, self._port)
            case "stop":
                raise StoppedError(message["why"])

    def _arm(self) -> None:
        try:
            if _is_remembered(self._rig):
                remember(self._port, None)
            self._controller.arm()
        except NotProvenOffError:
            raise
        except EldirError as error:
            if not self._controller.armed_once:  # nothing was heated: with the proof of that no stop stays
                self._controller.stop(str(error))
                end_driving(self._port)
                _remember_springs(self._controller, self._rig, self._port)
            raise

    def _report(self, report: Report) -> None:
        self._wire.send(**{"is": "report", "report": report})


def _is_remembered(rig: Rig) -> bool:
    """The springs of a virtual rig begin cold with it."""
    return rig.kind == "real"


def _remembered_springs(rig: Rig, port: Port) -> Springs | None:
    if not _is_remembered(rig):
        return None
    found = remembered(port)
    return at_the_ceiling(rig) if found is None else found


def _remember_springs(controller: PulseController, rig: Rig, port: Port) -> None:
    """After everything was proven off. Where it cannot be written they count as hot."""
    if _is_remembered(rig):
        with suppress(EldirError):
            remember(port, controller.heat_left())


def _asleep() -> float:
    """Seconds for which the computer was suspended since it started."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) - time.monotonic()


def _set_realtime_priority() -> None:
    """An edge waits neither for what was loaded to be searched for garbage, nor, where this user may ask
    for that, for other programs."""
    gc.collect()
    gc.freeze()
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(1))


def guard(wire: Wire) -> None:
    """Serve one parent to the end, and report the outcome to it, or to the terminal if it has died."""
    select.select([wire], [], [], _OPENING)
    first = wire.receive()
    if not first:
        return
    rig, port = Rig.from_json(first[0]["rig"]), first[0]["port"]
    named, sensor_port = first[0]["named"], first[0].get("sensor_port")
    clock = WallClock(EMULATED_PATIENCE) if rig.kind == "virtual" else WallClock()
    controller = device = None
    _set_realtime_priority()
    try:
        with (
            open_board(rig, clock, port) as board,
            open_sensor(rig, clock, sensor_port) as sensor,
        ):
            device = identify_open(board.handle, named)
            sensing = None if sensor is None else identify_open(sensor.handle, sensor_port or "")
            controller = PulseController(
                board,
                rig,
                clock,
                suspended=_asleep,
                sensor=sensor,
                may_close=partial(require_unstopped, device),
                before=_remembered_springs(rig, device),
            )
            devices = {"device": device.values(), "sensor": sensing and sensing.values()}
            wire.send(**{"is": "ready", "process": os.getpid()} | devices)
            try:
                session = _Session(wire, controller, rig, device, sensing)
                board.before_closing = session.refuse_signalled
                session.run()
            except BaseException as error:
                wire.send(**{"is": "opening"})
                _stop(controller, device, error)
                _logger.info("stopped, %s: %s", controller.proof or "not proven off", error)
                raise
    except EldirError as error:
        proven = not isinstance(error, NotProvenOffError)
        why, proof = str(error), controller.proof if controller is not None and proven else None
        heated = controller is not None and controller.armed_once
        if proof is not None and heated:
            why += f"; {proof}"
        if device is not None and heated and (elsewhere := moved(named, device)):
            why += f"; {elsewhere}"
        kind = {"kind": type(error).__name__, "code": error.code}
        heard = wire.send(**{"is": "stopped", "why": why, "proof": proof} | kind)
        if controller is not None and heated and proven:
            _remember_springs(controller, rig, device or port)
        if not heard or isinstance(error.__cause__, HeartbeatError):  # nobody else says it
            print_line(f"{named}: {why}", hazard=not proven)  # last: the terminal may stand still


def _stop(controller: PulseController, port: Port, error: BaseException) -> None:
    """Switch everything off, then latch the stop."""
    why, opened = reason_of(error), False
    if isinstance(error, NotProvenOffError) and not isinstance(error, CurrentFlowsError):
        latch(port, why)
        return
    try:
        controller.stop(why)
        opened = True
    except EldirError as failure:
        if isinstance(error, CurrentFlowsError) and isinstance(failure, CurrentFlowsError):
            return  # which is what ended the run
        hazard = failure
        if not isinstance(failure, NotProvenOffError):
            problem = f"not proven that everything is off: {failure}"
            hazard = NotProvenOffError(problem, remedy="cut the heating supply now")
        why = f"{hazard}; it was stopped because: {why}"  # what is hot stands first
        raise type(hazard)(why) from error
    finally:
        if controller.armed_once or isinstance(error, CurrentFlowsError):
            latch(port, why, opened=opened)


def main() -> None:
    """The process: its second argument is its end of the socket."""
    program_log.configure("guardian")
    with suppress(BrokenPipeError):
        guard(Wire(socket.socket(fileno=int(sys.argv[2]))))
