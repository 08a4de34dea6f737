"""`eldir rig off` without Typer and the packages that it does not need, so that heat is off soon."""

from __future__ import annotations

import threading
from functools import partial
from pathlib import Path

from eldir.errors import EldirError, InputError, report
from eldir_hardware.relay.errors import NotProvenOffError
from eldir_hardware.rig._board_hints import read_board_hints
from eldir_hardware.safety.off_targets import OffTarget, find_off_targets
from eldir_hardware.safety.stop_signals import StopSignals
from eldir_hardware.safety.switch_off import OffResult, switch_off

_OPTION_INDEX = {"--rig": 0, "--port": 1, "--board": 2}
_CUT_SUPPLY = "cut the heating supply now"


def run_quickly(arguments: list[str]) -> int | None:
    """Run `eldir rig off` with these arguments; return its exit status, or None for an unknown argument."""
    values: list[str | None] = [None, None, None]
    rest = [part for word in arguments for part in (word.split("=", 1) if word.startswith("--") else [word])]
    while rest:
        name = rest.pop(0)
        if name not in _OPTION_INDEX or not rest or rest[0].startswith("--"):
            return None
        values[_OPTION_INDEX[name]] = rest.pop(0)
    rig_file, port, board = values
    return run_off(None if rig_file is None else Path(rig_file), port, board)


def run_off(rig_file: Path | None, port: str | None, board: str | None) -> int:
    """Switch off, print the outcome, and return the exit status: 0 only if every port is proven off.

    Raises `EldirError` if no port is known. Signals that would end the program wait until the outcome is
    printed.
    """
    with StopSignals().handled():
        return _run_off(rig_file, port, board)


def _run_off(rig_file: Path | None, port: str | None, board: str | None) -> int:
    targets, remarks = find_off_targets(rig_file, port, board)
    outcomes = _switch_off_in_parallel(targets)
    failed = [outcome.port for outcome in outcomes if not outcome.proven]
    hazard = NotProvenOffError(
        f"not proven that everything is off at {', '.join(failed)}", remedy=_CUT_SUPPLY
    )
    if failed:
        report(hazard)  # first: stdout may be closed or full
    for remark in remarks:
        print(f"note: {remark}")
    is_virtual = rig_file is not None and port is None and read_board_hints(rig_file).is_portless
    ended = _end_virtual_runs(rig_file) if is_virtual and rig_file is not None else []
    if is_virtual and not outcomes and not ended:
        raise InputError(
            f"no program drives the virtual rig {rig_file} now: there is nothing to switch off",
            code="rig.virtual",
        )
    for sentence in ended:
        print(sentence)
    if not outcomes and not ended:
        if rig_file is None and port is None:
            _require_no_virtual_run()
        raise InputError(
            "no port is known that this computer drives",
            remedy=f"name it: eldir rig off --port PORT; if springs are hot, {_CUT_SUPPLY}",
        )
    for outcome in outcomes:
        print(f"{outcome.port}: {outcome.report}")
    flowing = [] if is_virtual else _print_currents(rig_file, targets)  # its sensor ends with its program
    if failed:
        raise hazard
    if flowing:
        raise flowing[0]
    if is_virtual:
        return 0
    print(f"to allow heating again: eldir rig reset --rig {rig_file or 'RIG'}")
    return 0


def _end_virtual_runs(rig_file: Path) -> list[str]:
    """End the runs of a virtual rig that have no port, as they are in virtual time; a sentence about each."""
    from eldir_hardware.run.virtual_runs import end_virtual_run, virtual_runs_of

    return [end_virtual_run(run) for run in virtual_runs_of(rig_file)]


def _require_no_virtual_run() -> None:
    """Raise `InputError` if all that plays on this computer is in virtual time: it heats nothing."""
    from eldir_hardware.run.virtual_runs import list_virtual_runs

    if logs := ", ".join(run.log.name for run in list_virtual_runs()):
        raise InputError(
            f"this computer drives no board; a run in virtual time, which heats nothing, writes {logs}",
            remedy=f"to end it: eldir rig off --rig RIG; if springs of another rig are hot, {_CUT_SUPPLY}",
            code="rig.virtual",
        )


def _print_currents(rig_file: Path | None, targets: list[OffTarget]) -> list[EldirError]:
    """Print what the current sensors of the runs measure, or else that of the rig file. Returns an error for
    each rig in which current flows; it is printed too."""
    recorded = [t.record for t in targets if t.record is not None and t.record.sensor is not None]
    has_sensor = rig_file is not None and read_board_hints(rig_file).sensor
    if not any(record.sensor_entries for record in recorded) and not has_sensor:
        return []
    from eldir_hardware.guardian.measured_heat import CurrentFlowsError, require_no_current
    from eldir_hardware.rig.configuration import Rig

    measured = [(partial(Rig.from_json, r.sensor_entries), r.sensor) for r in recorded if r.sensor_entries]
    if rig_file is not None and not measured:
        measured = [(partial(Rig.load, rig_file), next((r.sensor for r in recorded), None))]
    flowing: list[EldirError] = []
    for load, sensor in measured:
        try:
            rig = load()
            if reading := require_no_current(rig, sensor):
                print(f"{rig.name}: {reading}")
        except CurrentFlowsError as error:
            error.add_note(f"measured by the sensor of {rig.name}")
            report(error)
            flowing.append(error)
        except EldirError as error:
            print(f"note: no current was measured: {error}")
    return flowing


def _switch_off_in_parallel(targets: list[OffTarget]) -> list[OffResult]:
    """Switch off all boards at once: none must wait for another."""
    outcomes: dict[int, OffResult] = {}

    def switch(index: int) -> None:
        try:
            outcomes[index] = switch_off(targets[index])
        except Exception as error:
            text = f"{type(error).__name__}: {error}"
            outcomes[index] = OffResult(targets[index].port, False, text)

    threads = [threading.Thread(target=switch, args=[index]) for index in range(1, len(targets))]
    for thread in threads:
        thread.start()
    if targets:
        switch(0)
    for thread in threads:
        thread.join()
    return [outcomes[index] for index in range(len(targets))]
