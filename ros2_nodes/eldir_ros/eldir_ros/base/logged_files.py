# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Files of a run: in its log, or else those that parameters name."""

from __future__ import annotations

from typing import TypeVar

from rclpy.node import Node

from eldir.design import Design
from eldir.errors import InputError
from eldir_hardware.log.reader import read_attachment
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.vision.sources import LoggedFrames, open_source
from eldir_ros.base.parameters import find_file, get_file

_File = TypeVar("_File", Rig, Design, ActuationSchedule)


def find_log(node: Node, parameter: str) -> LoggedFrames | None:
    """The log that a parameter names; None where it is not set. Raises `InputError` for another file."""
    log = find_file(node, parameter)
    if log is None:
        return None
    source = open_source(log)
    if not isinstance(source, LoggedFrames):
        raise InputError("this is not the log of a run", expected="an MCAP file", found=str(log))
    return source


def read_from(log: LoggedFrames, name: str, kind: type[_File]) -> _File:
    """The file of that name in a log; raises `InputError` without."""
    found = read_attachment(log.attachments, log.name, name, kind.from_json)
    if found is None:
        raise InputError(
            f"{log.log.path} lacks {name}", expected="the log of a run", remedy="choose another log"
        )
    return found


def get_record(node: Node, parameter: str, log: LoggedFrames | None, name: str, kind: type[_File]) -> _File:
    """The file `name` in the log, or without a log the file that the parameter names."""
    return kind.load(get_file(node, parameter)) if log is None else read_from(log, name, kind)
