"""Settings of all tests."""

import atexit
import os
import shutil
import tempfile

import pytest
from hypothesis import HealthCheck, settings

from tests.reached_markers import add_markers

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


@pytest.hookimpl(tryfirst=True)  # before xdist reads the groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Real-time tests come first and lie in one group of xdist, so that never two of them run at once; then
    those of the simulated robots, in one group so that no kernel is loaded by two workers; then what is slow,
    so that no process has it left at the end. Other tests stay with those of their module."""
    order: dict[str, int] = {}
    for item in items:
        add_markers(item)
        group = _group(item)
        item.add_marker(pytest.mark.xdist_group(group))
        slow = item.get_closest_marker("slow") is not None
        order[group] = min(order.get(group, 3), {"realtime": 0, "kernels": 1}.get(group, 2 if slow else 3))
    items.sort(key=lambda item: order[_group(item)])


def _group(item: pytest.Item) -> str:
    if item.get_closest_marker("realtime"):
        return "realtime"
    kernels = item.location[0].startswith(_KERNELS) and not item.get_closest_marker("process")
    return "kernels" if kernels else item.location[0]


def pytest_runtest_setup(item: pytest.Item) -> None:
    """All other tests, with the programs that they start, yield to the real-time ones of another process."""
    if item.get_closest_marker("realtime") is None and os.getpriority(os.PRIO_PROCESS, 0) < _YIELDING:
        os.setpriority(os.PRIO_PROCESS, 0, _YIELDING)


_YIELDING = 10
_KERNELS = tuple(f"tests/eldir/{room}" for room in ("engine", "training", "evolution/test", "test_"))
