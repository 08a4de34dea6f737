"""The command `eldir rig reset`: the end of an emergency stop."""

from __future__ import annotations

import typer

from eldir_app.options import RigFile, load_real_rig


def reset(rig_file: RigFile) -> None:
    """Allow heating again after a stop.

    Every contact must be open by the board's report, and no current may flow where a sensor measures it.

    Example: eldir rig reset --rig rig.yaml
    """
    from eldir_hardware.guardian.measured_heat import require_no_current
    from eldir_hardware.rig.board_identity import identify_open
    from eldir_hardware.rig.devices import open_board
    from eldir_hardware.safety import spring_memory
    from eldir_hardware.safety.latch import require_proven_open, require_unlatched

    rig, port = load_real_rig(rig_file)
    with open_board(rig) as board:
        device = identify_open(board.file_descriptor, port)
        board.all_off()
        sensors = (record.sensor for record in require_proven_open(device) if record.sensor)
        measured = require_no_current(rig, next(sensors, None))
        spring_memory.reset_stop(device, rig)
    require_unlatched(device)
    report = f"all {rig.board.channels} channels are open by the board's report"
    typer.echo(f"{report}{f'; {measured}' if measured else ''}; the stop is reset")
