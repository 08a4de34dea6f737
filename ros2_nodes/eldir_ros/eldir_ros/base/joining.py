# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Errors of joining a graph: with SROS 2 a program may use only the names that its enclave allows."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from rclpy._rclpy_pybind11 import RCLError

from eldir.errors import EldirError


@contextmanager
def ros_errors_as_eldir_errors() -> Iterator[None]:
    """Raise errors of the middleware in this context as `EldirError`, with the reason in one line."""
    try:
        yield
    except RCLError as error:
        reason = str(error).splitlines()[0].split(", at ")[0]
        if os.environ.get("ROS_SECURITY_ENABLE") != "true":
            raise EldirError(f"the graph cannot be joined: {reason}") from error
        enclave = os.environ.get("ROS_SECURITY_ENCLAVE_OVERRIDE", "/")
        raise EldirError(
            f"the graph cannot be joined: {reason}",
            expected="keys and permissions for what this program does (SROS 2)",
            found=f"enclave {enclave}",
            remedy="name an enclave that may do it in ROS_SECURITY_ENCLAVE_OVERRIDE",
        ) from error
