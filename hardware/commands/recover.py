"""The command `eldir recover`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def recover(
    log: Annotated[Path, typer.Argument(help="A log that was cut off or damaged (MCAP).")],
    *,
    out: Annotated[Path, typer.Option(help="The sound log to write.")],
) -> None:
    """Make a sound log of a damaged one, as far as data exist; nothing whose check sum is wrong gets in.

    Example: eldir recover log.mcap --out whole.mcap
    """
    from hardware.log.recover import recover as rescue

    found = rescue(log, out)
    kept = ", ".join(found.attachments) or "no attachments"
    print(f"{out}: {found.messages} messages over {found.seconds:.1f} s, {kept}; {found.losses}")
