"""Which logs belong to what is driven: those of the program that plays, or of a recorder beside it."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from eldir_app.watch.driven_rigs import driven_ports, ports_of_log, ports_of_rig
from tests.app.watch.bench import heating
from tests.forked_programs import Forked
from tests.hardware.emulated_rigs import emulated, heating_program, rig_file, wait

RECORD = """
import sys, time
from pathlib import Path
from eldir_hardware.log.background import RunRecording
rig, log = map(Path, sys.argv[1:])
recording = RunRecording(log, ["channel1"], ["spring0_front"], time.time_ns())
recording.attach({"schedule.json": b"{}", "rig.yaml": rig.read_bytes()})
print("begun", flush=True)
while True:
    recording.on_board(time.time_ns(), [False], [22.0])
    time.sleep(0.05)
"""


@contextmanager
def recorder(rig: Path, log: Path) -> Iterator[None]:
    """A process that records as the recorder of a ROS 2 graph does, and drives nothing."""
    words = [sys.executable, "-c", RECORD, str(rig), str(log)]
    with Forked(words, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout.readline() == "begun\n"
            yield
        finally:
            process.kill()


def test_the_log_of_a_recorder_beside_the_program_is_found_by_its_rig(tmp_path: Path) -> None:
    with emulated("lcus") as board:
        rig = rig_file(tmp_path / "rig.yaml", "lcus", board.port, name="bench of a graph")
        another = rig_file(tmp_path / "another.yaml", "lcus", "/dev/no-board", name="another bench")
        log, other = tmp_path / "log.mcap", tmp_path / "other.mcap"
        with (
            recorder(rig, log),
            recorder(another, other),
            heating_program(board, rig, child_guardian=True) as (program, guardian),
        ):
            assert wait(lambda: [d.logs for d in ports_of_rig(rig)] == [(log,)])
            (found,) = ports_of_log(log)
            assert (found.guardian, found.player) == (guardian, program.pid)
            assert not found.accepts_commands and not ports_of_log(other)
    assert wait(lambda: not [d for d in driven_ports() if d.port == board.port])


def test_a_program_that_writes_its_own_log_has_no_other(tmp_path: Path) -> None:
    with heating(tmp_path / "run") as run, recorder(run.rig, tmp_path / "beside.mcap"):
        (found,) = ports_of_rig(run.rig)
        assert found.logs == (run.log,) and found.player == run.player.pid and found.accepts_commands
        assert not ports_of_log(tmp_path / "beside.mcap") and os.path.samefile(found.port, run.board.port)
