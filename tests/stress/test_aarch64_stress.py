"""The engine's tests on an emulated aarch64: wheels, the other compiler and NEON, without such a machine.

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
    """Run a program of that system; all that it starts ends with it."""
    alone = ["unshare", "--mount", "--pid", "--fork", "--kill-child", f"--mount-proc={system / 'proc'}"]
    inside = [shutil.which("chroot") or "/usr/sbin/chroot", system, "env", "-C", "/eldir", *command]
    environment = {
        "PATH": "/usr/bin:/bin",
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


def test_the_engine_passes_its_tests(aarch64):
    told = emulated(aarch64, "python3", "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/engine")
    print(told[-400:])
    assert re.search(r"\d\d passed", told)
