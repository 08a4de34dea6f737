# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The public part of rclpy (Jazzy) that the nodes use; a test holds it against the installed rclpy."""

from collections.abc import Sequence
from typing import Any

from rclpy import utilities as utilities
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

def init(
    *,
    args: Sequence[str] | None = ...,
    context: Context | None = ...,
    domain_id: int | None = ...,
    signal_handler_options: SignalHandlerOptions | None = ...,
) -> Any: ...
def create_node(node_name: str, *, context: Context | None = ..., namespace: str | None = ...) -> Node: ...
def try_shutdown(*, context: Context | None = ...) -> None: ...
def get_rmw_implementation_identifier() -> str: ...
