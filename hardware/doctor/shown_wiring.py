"""Shows a person which spring each channel heats: `eldir rig doctor --wiring`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from eldir.design import Design
from eldir.parameters.wiring import Connection, for_motors
from hardware.doctor.warm_springs import PAUSE, WARM, place_of, warm_each, warming_pulse
from hardware.rig.configuration import Rig
from hardware.run.drive import robot_file
from hardware.run.opened_rig import bank_of
from hardware.safety.stop_signals import signals_as_errors


def show_wiring(rig: Rig, rig_file: Path, design: Path | None, say: Callable[[str], None]) -> None:
    """Warm one spring after the other, and say which one it must be.

    `design`: file of the robot, instead of the one that the rig file names; without any, all channels of the
    rig file are heated and places are not told.
    """
    path = robot_file(rig, rig_file, design)
    body = None if path is None else Design.load(path).morphology
    connections = for_motors(rig.channels, rig.motors if body is None else body.motors)
    length = warming_pulse(rig)
    say(
        f"each channel heats for {length:g} s, to less than {WARM:g} C, and rests for {PAUSE:g} s; "
        "Ctrl-C opens all contacts at once"
    )

    def tell(connection: Connection) -> None:
        say(f"channel {connection.channel}: {place_of(connection, body)} must grow warm")

    def tell_rest(seconds: float) -> None:
        say(f"the springs rest from the run before, for {seconds:.0f} s")

    with signals_as_errors(), bank_of(rig) as opened:
        warm_each(opened.bank, opened.clock, connections, length, tell, rest=tell_rest)
    say(f"all contacts are open. If another spring grew warm, correct `channels` in {rig_file} or the wires")
