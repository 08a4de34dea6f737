# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

from collections.abc import Callable
from enum import Enum
from typing import Any

from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.task import Future

class GoalResponse(Enum):
    REJECT = ...
    ACCEPT = ...

class CancelResponse(Enum):
    REJECT = ...
    ACCEPT = ...

class ActionServer:
    def __init__(
        self,
        node: Node,
        action_type: type[Any],
        action_name: str,
        execute_callback: Callable[[ServerGoalHandle], Any],
        *,
        callback_group: CallbackGroup | None = ...,
        goal_callback: Callable[[Any], GoalResponse] = ...,
        handle_accepted_callback: Callable[[ServerGoalHandle], None] = ...,
        cancel_callback: Callable[[ServerGoalHandle], CancelResponse] = ...,
    ) -> None: ...

class ActionClient:
    def __init__(self, node: Node, action_type: type[Any], action_name: str) -> None: ...
    def server_is_ready(self) -> bool: ...
    def send_goal_async(self, goal: Any, feedback_callback: Callable[[Any], None] | None = ...) -> Future: ...
    def destroy(self) -> None: ...
