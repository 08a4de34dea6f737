"""Settings of all tests."""

import atexit
import os
import shutil
import tempfile

from hypothesis import HealthCheck, settings

# How long an example takes is no property of ours: machines are busy, and Taichi compiles at first use.
# Where a change is judged (CI is set by every such service) the same examples come every time.
settings.register_profile(
    "eldir",
    deadline=None,
    derandomize=bool(os.environ.get("CI")),
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("eldir")

# Records of driven boards and latched stops, also of the programs that tests start: not those of this user.
_STATE = tempfile.mkdtemp(prefix="eldir-state-")
atexit.register(shutil.rmtree, _STATE, ignore_errors=True)
os.environ["XDG_STATE_HOME"] = _STATE
