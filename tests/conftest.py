"""Settings of all tests."""

import atexit
import gc
import os
import shutil
import tempfile
from importlib import import_module

import pytest
from hypothesis import HealthCheck, settings

from tests.forked_programs import fork_guardians
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

# Programs that tests start buffer what they print, as those that a person starts.
os.environ.pop("PYTHONUNBUFFERED", None)

# Before NumPy is imported: threads of OpenBLAS wait for each other in a loop.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# What is imported and collected stays: looking through it again and again takes a third of collecting, and
# some tenths of a second each time afterwards.
gc.disable()


def pytest_collection_finish() -> None:
    fork_guardians()
    gc.freeze()
    gc.enable()


# Importing the compiler looks through all modules that are loaded, some hundred times: first, not last.
if "PYTEST_XDIST_WORKER" in os.environ:
    import_module("eldir.engine.compiler")

# Records of driven boards and latched stops, also of the programs that tests start: not those of this user.
_STATE = tempfile.mkdtemp(prefix="eldir-state-")
atexit.register(shutil.rmtree, _STATE, ignore_errors=True)
os.environ["XDG_STATE_HOME"] = _STATE


@pytest.hookimpl(tryfirst=True)  # before xdist reads the groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Real-time tests come first and lie in two groups of xdist, so that never more than two of them run at
    once, and at most one of those with close deadlines; then those of the simulated robots, in one group so
    that no kernel is loaded by two workers; then what is slow, the slowest module first (`slow(seconds)`), so
    that no process has it left at the end. Other tests stay with those of their module."""
    groups: dict[pytest.Item, str] = {}
    order: dict[str, float] = {}
    for item in items:
        add_markers(item)
        groups[item] = group = _group(item)
        item.add_marker(pytest.mark.xdist_group(group))
        order[group] = min(order.get(group, 0.0), _FIRST.get(group, -_seconds(item)))
    items.sort(key=lambda item: order[groups[item]])


def _seconds(item: pytest.Item) -> float:
    """Processor time of a slow test or of its whole module, as its marker says; 0 of others."""
    slow = item.get_closest_marker("slow")
    return 0.0 if slow is None else float(slow.args[0]) if slow.args else 5.0


def _group(item: pytest.Item) -> str:
    file = item.nodeid.partition("::")[0]  # `location` takes twenty times as long
    if item.get_closest_marker("realtime"):
        return "waiting" if file.startswith(_WAITING) else "realtime"
    return "kernels" if file.startswith(_KERNELS) and not item.get_closest_marker("process") else file


def pytest_runtest_setup(item: pytest.Item) -> None:
    """All other tests, with the programs that they start, yield to the real-time ones of another process."""
    if item.get_closest_marker("realtime") is None and os.getpriority(os.PRIO_PROCESS, 0) < _YIELDING:
        os.setpriority(os.PRIO_PROCESS, 0, _YIELDING)


_YIELDING = 10
_FIRST = {"realtime": -3e4, "waiting": -2e4, "kernels": -1e4}
_WAITING = (
    "tests/app/commands",
    "tests/app/notify",
    *(f"tests/hardware/relay/test_{name}" for name in ("board", "frames", "own_board", "relays")),
    "tests/hardware/rig",
    "tests/hardware/run/test_moved_link",
    "tests/hardware/safety",
)
"""Their tests mostly wait for boards that are silent: a tenth of a processor is enough for them, and what
must happen within a time takes about a third of it."""
_KERNELS = tuple(f"tests/eldir/{room}" for room in ("engine", "training", "evolution/test", "test_"))
