"""A packet as the command writes it, made once in a run of the tests: it takes ten seconds."""

from __future__ import annotations

from contextlib import redirect_stdout
from pathlib import Path

import pytest

from eldir_app.commands.packet import packet
from tests.cad.drawn_bodies import BLOCK, design
from tests.made_once import made_once
from tests.processor_time import in_units, processor_seconds

ROBOT = design(*BLOCK, motors=(3, 20))


def written_packet(temporary: pytest.TempPathFactory) -> Path:
    """The folder of the robot's packet, for reading only; beside it lie the design and what was said."""

    def make() -> Path:
        folder = temporary.mktemp("packets")
        ROBOT.save(folder / "design.json")

        def run() -> None:
            with (folder / "said").open("w") as said, redirect_stdout(said):
                packet(folder / "design.json", folder / "packet", as_json=True)

        assert in_units(processor_seconds(run)) < 4000  # it takes about 400
        return folder / "packet"

    return made_once(temporary, "packet", make)
