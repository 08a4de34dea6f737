# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Sends the log records of the toolkit through a node's logger: to the screen and to /rosout."""

from __future__ import annotations

import logging
import os
from typing import Any

from eldir.core.program_log import VARIABLE, configure

_NAMES = {10: "debug", 20: "info", 30: "warning"}  # ROS's severities have the numbers of Python's levels


def forward_records(program: str, logger: Any) -> None:
    """Give all records of this process to the logger of a node, and take over its level.

    `ELDIR_LOG` counts more than the level of the node, and the guardian, which writes to stderr itself,
    inherits it.
    """
    os.environ.setdefault(VARIABLE, _NAMES.get(int(logger.get_effective_level()), "error"))
    configure(program, NodeLogHandler(logger))


class NodeLogHandler(logging.Handler):
    """Gives records to the logger of a node."""

    def __init__(self, logger: Any):
        super().__init__()
        self._logger = logger

    def emit(self, record: logging.LogRecord) -> None:
        text = f"{record.name}: {self.format(record)}"
        # To rclpy a line of code has one severity for ever: each needs a line of its own.
        if record.levelno >= logging.ERROR:
            self._logger.error(text)
        elif record.levelno >= logging.WARNING:
            self._logger.warning(text)
        elif record.levelno >= logging.INFO:
            self._logger.info(text)
        else:
            self._logger.debug(text)
