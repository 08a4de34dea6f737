# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Most of these tests need a ROS 2 graph; each such module says so where there is none, and is skipped."""

import atexit
import os
import shutil
import signal
import tempfile

import pytest

collect_ignore = ["graph.py", "schedules.py", "launching/virtual_rig_launch_test.py"]


@pytest.fixture(autouse=True)
def private_domain(monkeypatch):
    """Nobody else's nodes, on this machine only; fields of messages are checked."""
    for name, value in _PRIVATE.items():
        monkeypatch.setenv(name, value)


# Ignored under `nohup` or in the background, also by what is started; here nodes and clients end by them.
for _number in (signal.SIGHUP, signal.SIGINT, signal.SIGQUIT):
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, signal.default_int_handler)

_STATE = tempfile.mkdtemp(prefix="eldir-state-")  # latched stops: not those of this user
atexit.register(shutil.rmtree, _STATE, ignore_errors=True)
_PRIVATE = {
    "XDG_STATE_HOME": _STATE,
    "ROS_DOMAIN_ID": str(100 + os.getpid() % 100),
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    "ROS_PYTHON_CHECK_FIELDS": "1",
    "ELDIR_THREADS": "1",
}
