"""Settings of all tests."""

import os

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
