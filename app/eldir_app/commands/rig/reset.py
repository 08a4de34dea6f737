"""The command `eldir rig reset`: the end of an emergency stop."""

from __future__ import annotations

import typer

from eldir_app.terminal.rig_file import RigFile, real_rig_and_port


def reset(rig_file: RigFile) -> None:
    """Allow heating again after a stop.

    Every contact must be open by the board's report, and no current may flow where a sensor measures it.

    Example: eldir rig reset --rig rig.yaml
    """
    from eldir_hardware.guardian.measured_heat import require_no_current
    from eldir_hardware.rig.board_identity import identify_open
    from eldir_hardware.rig.boards import open_board
    from eldir_hardware.safety import spring_memory
    from eldir_hardware.safety.latch import require_proven_open, require_unlatched

    loaded, port = real_rig_and_port(rig_file)
    with open_board(loaded) as board:
        device = identify_open(board.handle, port)
        board.all_off()
        sensors = (record.sensor for record in require_proven_open(device) if record.sensor)
        measured = require_no_current(loaded, next(sensors, None))
        spring_memory.reset(device, loaded)
    require_unlatched(device)
    proof = f"all {loaded.board.channels} channels are open by the board's report"
    typer.echo(f"{proof}{f'; {measured}' if measured else ''}; the stop is reset")
