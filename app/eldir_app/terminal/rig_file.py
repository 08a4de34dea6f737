"""The rig file of commands, and the port of a real rig."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eldir.errors import InputError

if TYPE_CHECKING:
    from eldir_hardware.rig.configuration import Rig

RigFile = Annotated[Path, typer.Option("--rig", help="The rig file.")]


def real_rig_and_port(rig_file: Path) -> tuple[Rig, str]:
    """The rig and its port. Raises `InputError` for a virtual rig, which has no port."""
    from eldir_hardware.rig.configuration import Rig

    loaded = Rig.load(rig_file)
    if loaded.kind == "virtual" or loaded.board.port is None:
        raise InputError(
            f"{rig_file} is a virtual rig: it has no port and heats nothing",
            code="rig.virtual",
            expected="kind: real",
        )
    return loaded, loaded.board.port
