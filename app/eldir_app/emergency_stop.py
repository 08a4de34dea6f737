"""`eldir rig off` without the command line's machinery: heat must not wait for what this does not need."""

from __future__ import annotations

import threading
from pathlib import Path

from eldir.errors import EldirError, InputError, report
from eldir_hardware.relay.errors import NotProvenOffError
from eldir_hardware.rig.board_hints import read_board_hints
from eldir_hardware.safety.off_targets import Target, off_targets
from eldir_hardware.safety.stop_signals import Stop
from eldir_hardware.safety.switch_off import Outcome, switch_off

_OPTIONS = {"--rig": 0, "--port": 1, "--board": 2}
_CUT = "cut the heating supply now"


def run_quickly(words: list[str]) -> int | None:
    """Run `eldir rig off` with these words; returns its exit status, or None for unknown words."""
    given: list[str | None] = [None, None, None]
    rest = [part for word in words for part in (word.split("=", 1) if word.startswith("--") else [word])]
    while rest:
        name = rest.pop(0)
        if name not in _OPTIONS or not rest or rest[0].startswith("--"):
            return None
        given[_OPTIONS[name]] = rest.pop(0)
    return run_off(None if given[0] is None else Path(given[0]), given[1], given[2])


def run_off(rig_file: Path | None, port: str | None, board: str | None) -> int:
    """Switch off, print what was done, and return the exit status: 0 only if every port is proven off.

    Raises `EldirError` if there is nothing that could be switched off. Signals that would end the program
    wait until it has said what is proven.
    """
    with Stop().caught():
        return _run_off(rig_file, port, board)


def _run_off(rig_file: Path | None, port: str | None, board: str | None) -> int:
    targets, remarks = off_targets(rig_file, port, board)
    outcomes = _in_parallel(targets)
    failed = [outcome.port for outcome in outcomes if not outcome.proven]
    hazard = NotProvenOffError(f"not proven that everything is off at {', '.join(failed)}", remedy=_CUT)
    if failed:
        report(hazard)  # first: what follows may not be written
    for remark in remarks:
        print(f"note: {remark}")
    if not outcomes:
        raise InputError(
            "no port is known that this computer drives",
            remedy=f"name it: eldir rig off --port PORT; if springs are hot, {_CUT}",
        )
    for outcome in outcomes:
        print(f"{outcome.port}: {outcome.text}")
    if failed:
        raise hazard
    if rig_file is not None and read_board_hints(rig_file).sensor:
        _measure(rig_file, targets)
    print(f"to allow heating again: eldir rig reset --rig {rig_file or 'RIG'}")
    return 0


def _measure(rig_file: Path, targets: list[Target]) -> None:
    """Print what the current sensor of the run says, or that of the file without one. Raises `EldirError`
    where current flows."""
    from eldir_hardware.guardian.measured_heat import CurrentFlowsError, require_no_current
    from eldir_hardware.rig.configuration import Rig

    try:
        sensors = (t.record.sensor for t in targets if t.record and t.record.sensor)
        print(require_no_current(Rig.load(rig_file), next(sensors, None)))
    except CurrentFlowsError:
        raise
    except EldirError as error:
        print(f"note: no current was measured: {error}")


def _in_parallel(targets: list[Target]) -> list[Outcome]:
    """One board must not wait for another."""
    outcomes: dict[int, Outcome] = {}

    def switch(number: int) -> None:
        try:
            outcomes[number] = switch_off(targets[number])
        except Exception as error:
            text = f"{type(error).__name__}: {error}"
            outcomes[number] = Outcome(targets[number].port, False, text)

    threads = [threading.Thread(target=switch, args=[number]) for number in range(1, len(targets))]
    for thread in threads:
        thread.start()
    if targets:
        switch(0)
    for thread in threads:
        thread.join()
    return [outcomes[number] for number in range(len(targets))]
