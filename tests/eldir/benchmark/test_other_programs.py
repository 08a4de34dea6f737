"""What other programs use during a measurement."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from eldir.benchmark.other_programs import OtherPrograms, _own_ticks, watch_other_programs
from eldir.benchmark.tables import text_table


def _write(proc: Path, cores: list[int], processes: dict[int, tuple[int, list[int]]]) -> None:
    """Files as in proc(5), as far as they are read: `cores` from user to steal; parent and ticks of each
    process."""
    (proc / "stat").write_text(f"cpu  {' '.join(map(str, cores))} 0 0\ncpu0 1 2 3\n")
    for number, (parent, ticks) in processes.items():
        (proc / str(number)).mkdir(exist_ok=True)
        rest = " ".join(map(str, [parent, *[0] * 9, *ticks, 20, 0]))
        (proc / str(number) / "stat").write_text(f"{number} (a (strange) name) S {rest}\n")


def test_what_is_neither_idle_nor_of_its_own_processes_is_of_others(tmp_path: Path) -> None:
    own = os.getpid()
    _write(tmp_path, [100, 50, 0, 800, 50, 0, 0, 0], {own: (1, [10, 0, 0, 0]), own + 1: (own, [0] * 4)})
    with watch_other_programs(tmp_path) as found:
        # 400 ticks: 100 idle, 40 waiting; the process has 60 and 30 of an ended child, a grandchild 50
        _write(
            tmp_path,
            [230, 80, 60, 900, 90, 10, 10, 20],
            {
                own: (1, [50, 30, 20, 10]),
                own + 1: (own, [0] * 4),
                own + 2: (own + 1, [50, 0, 0, 0]),
                own + 3: (1, [70, 0, 0, 0]),
            },
        )
        assert found.share is None
    assert found.share == pytest.approx((260 - 100 - 50) / 400)


def test_where_nothing_is_known_nothing_is_said_about_the_machine(tmp_path: Path) -> None:
    with watch_other_programs(tmp_path) as found:
        pass
    assert found.share is None and "does not tell" in found.describe()
    _write(tmp_path, [0] * 8, {})  # as in some containers
    with watch_other_programs(tmp_path) as found:
        pass
    assert found.share is None
    assert OtherPrograms(0.09).describe().endswith("9 % of the processor meanwhile: the machine was quiet.")
    assert "31 % of the processor meanwhile: the machine was busy." in OtherPrograms(0.31).describe()


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs Linux")
def test_a_child_s_time_is_its_parent_s() -> None:
    """While it lives, and after its end."""
    code = "import time\nwhile time.process_time() < 0.15: pass\nprint(flush=True)\ninput()"
    before = _own_ticks(Path("/proc"), os.getpid())
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as child:
        assert child.stdout and child.stdout.readline()
        alive = _own_ticks(Path("/proc"), os.getpid())
        child.communicate(b"\n")
    ended = _own_ticks(Path("/proc"), os.getpid())
    assert before + 0.14 * os.sysconf("SC_CLK_TCK") <= alive <= ended


def test_columns_are_aligned() -> None:
    printed = text_table(["task", "time [s]"], [["a", "1.25"], ["longer", "110"]])
    assert printed == "task    time [s]\na           1.25\nlonger       110"
