"""What the toolkit logs comes out of a node's logger, at the node's level; without ROS."""

import inspect
import logging
import os

import pytest

from eldir.core import program_log
from eldir_ros.base.node_log import NodeLogHandler, forward_records


class RosLogger:
    """A logger with the rule of rclpy's: the severity of a line of code never changes."""

    def __init__(self, level: int):
        self.level, self.said, self._severities = level, [], {}

    def get_effective_level(self) -> int:
        return self.level

    def _log(self, severity: str, text: str) -> None:
        caller = inspect.stack()[2]
        if self._severities.setdefault((caller.filename, caller.lineno), severity) != severity:
            raise ValueError("Logger severity cannot be changed between calls.")
        self.said.append((severity, text))

    def debug(self, text: str) -> None:
        self._log("debug", text)

    def info(self, text: str) -> None:
        self._log("info", text)

    def warning(self, text: str) -> None:
        self._log("warning", text)

    def error(self, text: str) -> None:
        self._log("error", text)


@pytest.fixture
def forwarded(monkeypatch):
    """Forwards records of this process until the test ends."""
    root, levels = logging.getLogger(), {n: logging.getLogger(n).level for n in program_log.PACKAGES}
    raises = logging.raiseExceptions

    def begin(level: int, log: str | None = None) -> RosLogger:
        monkeypatch.delenv("ELDIR_LOG", raising=False)
        if log is not None:
            monkeypatch.setenv("ELDIR_LOG", log)
        logger = RosLogger(level)
        forward_records("relay_board", logger)
        return logger

    yield begin
    for handler in [h for h in root.handlers if isinstance(h, NodeLogHandler)]:
        root.removeHandler(handler)
    for name, level in levels.items():
        logging.getLogger(name).setLevel(level)
    logging.raiseExceptions = raises


def log_all() -> None:
    own = logging.getLogger("eldir_hardware.safety.latch")
    for _ in range(2):
        own.debug("read %d records", 3)
        own.info("latched")
        own.warning("odd")
        own.error("gone")
        own.critical("hot")


ALL = [
    ("debug", "eldir_hardware.safety.latch: read 3 records"),
    ("info", "eldir_hardware.safety.latch: latched"),
    ("warning", "eldir_hardware.safety.latch: odd"),
    ("error", "eldir_hardware.safety.latch: gone"),
    ("error", "eldir_hardware.safety.latch: hot"),
]


@pytest.mark.parametrize(("level", "first"), [(10, 0), (20, 1), (30, 2), (40, 3), (50, 3)])
def test_records_have_the_level_of_the_node(level, first, forwarded):
    logger = forwarded(level)
    log_all()
    assert logger.said == 2 * ALL[first:]
    names = {10: "debug", 20: "info", 30: "warning"}
    assert os.environ["ELDIR_LOG"] == names.get(level, "error"), "the guardian inherits it"


def test_the_variable_counts_more(forwarded):
    logger = forwarded(20, "eldir_hardware.safety=debug,error")
    log_all()
    logging.getLogger("eldir_hardware.run").warning("not asked for")
    assert logger.said == 2 * ALL
    assert os.environ["ELDIR_LOG"] == "eldir_hardware.safety=debug,error"
