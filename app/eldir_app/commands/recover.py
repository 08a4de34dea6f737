"""The command `eldir recover`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def recover(
    log: Annotated[Path, typer.Argument(help="Damaged or incomplete log (MCAP).")],
    *,
    out: Annotated[Path, typer.Option(help="Repaired log to write (MCAP).")],
) -> None:
    """Repair a damaged log: keep every record whose checksum is right, and report what is missing.

    Example: eldir recover log.mcap --out whole.mcap
    """
    from eldir.core.files import require_ending
    from eldir_hardware.log.recover import recover_log

    require_ending("--out", out, ".mcap")
    recovered = recover_log(log, out)
    attachments = ", ".join(recovered.attachments) or "no attachments"
    size = f"{recovered.messages} messages over {recovered.seconds:.1f} s"
    print(f"{out}: {size}, {attachments}; {recovered.losses}")
