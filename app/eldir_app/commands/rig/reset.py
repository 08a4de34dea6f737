"""The command `eldir rig reset`: the end of an emergency stop."""

from __future__ import annotations

import typer

from eldir_app.options import RigFile, load_real_rig


def reset(rig_file: RigFile) -> None:
    """Allow heating again after a stop.

    Every contact must be open by the board's report, and no current may flow where a sensor measures it.

    Example: eldir rig reset --rig rig.yaml
    """
    from eldir_hardware.guardian.off_proof import reset_emergency_stop

    rig, _ = load_real_rig(rig_file)
    measured = reset_emergency_stop(rig)
    report = f"all {rig.board.channels} channels are open by the board's report"
    typer.echo(f"{report}{f'; {measured}' if measured else ''}; the stop is reset")
