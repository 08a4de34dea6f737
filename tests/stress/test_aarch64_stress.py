"""Tests on an emulated aarch64: wheels, the other compiler and NEON, the rig, without such a machine.

As root on Debian, with `apt install debootstrap qemu-user-static binfmt-support` and, in a container,
`mount -t binfmt_misc none /proc/sys/fs/binfmt_misc; update-binfmts --enable qemu-aarch64`.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.stress

ROOT = Path(__file__).parents[2]
PACKAGES = "python3,libgl1,libglib2.0-0,ca-certificates"
RIG = (
    "all_off board_answers board_commands board_interface board_line board_sizes edges guardian_process "
    "guardian_session log player recover relays schedule schedule_digests schedule_values state state_folder "
    "vision"
)
"""Tests of tests/hardware that an emulated processor is not too slow for."""
LEFT_OUT = shutil.ignore_patterns(".git", ".venv*", "build", "__pycache__", ".*_cache", "node_modules")


@pytest.fixture(scope="module")
def aarch64(tmp_path_factory):
    """Folder of a small Debian 12 for aarch64 with the toolkit's wheels; programs of it run emulated."""
    if os.geteuid() != 0 or shutil.which("debootstrap") is None:
        pytest.skip("needs root and debootstrap")
    if not Path("/proc/sys/fs/binfmt_misc/qemu-aarch64").exists():
        pytest.skip("programs for aarch64 do not run here: see this module's first lines")
    system = tmp_path_factory.mktemp("aarch64") / "system"
    make = ["debootstrap", "--arch=arm64", "--variant=minbase", f"--include={PACKAGES}", "bookworm", system]
    subprocess.run(make, check=True, stdout=subprocess.DEVNULL)
    shutil.copytree(ROOT, system / "eldir", ignore=LEFT_OUT)
    uv = Path(sys.executable).with_name("uv")
    wheels = ["--python-platform", "aarch64-manylinux_2_36", "--python-version", "3.11"]
    constraints = ["-c", ROOT / ".ci/constraints.txt", "--target", system / "site"]
    install = [uv, "pip", "install", "-q", *wheels, *constraints, f"{system / 'eldir'}[test]"]
    subprocess.run(install, check=True)
    yield system
    shutil.rmtree(system)


def emulated(system, *command):
    """Run a program of that system, with this machine's devices; all that it starts ends with it."""
    alone = ["unshare", "--mount", "--pid", "--fork", "--kill-child", f"--mount-proc={system / 'proc'}"]
    enter = 'mount --rbind /dev "$0/dev" && exec chroot "$0" env -C /eldir "$@"'  # pseudo-terminals
    inside = ["sh", "-c", enter, system, *command]
    environment = {
        "PATH": "/usr/sbin:/usr/bin:/sbin:/bin",
        "HOME": "/root",
        "LC_ALL": "C.UTF-8",
        "PYTHONPATH": "/site",
        "ELDIR_THREADS": "1",
    }
    done = subprocess.run([*alone, *inside], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
    return done.stdout


def test_the_command_names_its_compiler(aarch64):
    assert emulated(aarch64, "uname", "-m").strip() == "aarch64"
    told = emulated(aarch64, "python3", "-m", "eldir", "--version")
    assert "quadrants" in told and "taichi" not in told


def passed(system, *arguments):
    """How many tests pass; none may fail."""
    told = emulated(system, "python3", "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments)
    print(told[-400:])
    return int(re.search(r"(\d+) passed", told)[1])


def test_the_engine_passes_its_tests(aarch64):
    assert passed(aarch64, "tests/eldir/engine") > 80


def test_the_rig_half_passes_its_tests(aarch64):
    """Emulated boards on pseudo-terminals, guardians that are killed, logs, tracking."""
    rooms = ROOT / "tests" / "hardware"
    paths = [p.relative_to(ROOT) for name in RIG.split() for p in rooms.rglob(f"test_{name}.py")]
    assert passed(aarch64, *paths, "-k", "not in_a_second") > 800
