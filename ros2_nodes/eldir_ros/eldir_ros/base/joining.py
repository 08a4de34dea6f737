# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Joining a graph that may refuse: SROS 2 lets a program use only the names that its enclave allows."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from rclpy._rclpy_pybind11 import RCLError

from eldir.errors import EldirError


@contextmanager
def joining() -> Iterator[None]:
    """What the middleware refuses in this context is an `EldirError`, with the reason in one line."""
    try:
        yield
    except RCLError as error:
        why = str(error).splitlines()[0].split(", at ")[0]
        if os.environ.get("ROS_SECURITY_ENABLE") != "true":
            raise EldirError(f"the graph cannot be joined: {why}") from error
        enclave = os.environ.get("ROS_SECURITY_ENCLAVE_OVERRIDE", "/")
        raise EldirError(
            f"the graph cannot be joined: {why}",
            expected="keys and permissions for what this program does (SROS 2)",
            found=f"enclave {enclave}",
            remedy="name an enclave that may do it in ROS_SECURITY_ENCLAVE_OVERRIDE",
        ) from error
