# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock
from rclpy.context import Context
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.timer import Timer

_Message = TypeVar("_Message")

class _EndpointInfo(NamedTuple):
    node_name: str

class Node:
    def __init__(
        self, node_name: str, *, context: Context | None = ..., namespace: str | None = ..., **options: Any
    ) -> None: ...
    @property
    def context(self) -> Context: ...
    def create_publisher(
        self, msg_type: type[_Message], topic: str, qos_profile: QoSProfile | int
    ) -> Publisher[_Message]: ...
    def create_subscription(
        self,
        msg_type: type[_Message],
        topic: str,
        callback: Callable[[_Message], None],
        qos_profile: QoSProfile | int,
        *,
        callback_group: CallbackGroup | None = ...,
    ) -> Any: ...
    def create_service(
        self,
        srv_type: type[Any],
        srv_name: str,
        callback: Callable[[Any, Any], Any],
        *,
        callback_group: CallbackGroup | None = ...,
    ) -> Any: ...
    def create_timer(
        self,
        timer_period_sec: float,
        callback: Callable[[], None],
        callback_group: CallbackGroup | None = ...,
        clock: Clock | None = ...,
        autostart: bool = ...,
    ) -> Timer: ...
    def declare_parameter(
        self,
        name: str,
        value: Any = ...,
        descriptor: ParameterDescriptor | None = ...,
        ignore_override: bool = ...,
    ) -> Parameter: ...
    def undeclare_parameter(self, name: str) -> None: ...
    def get_parameter(self, name: str) -> Parameter: ...
    def get_parameter_or(self, name: str, alternative_value: Parameter | None = ...) -> Parameter: ...
    def describe_parameter(self, name: str) -> ParameterDescriptor: ...
    def destroy_node(self) -> None: ...
    def get_clock(self) -> Clock: ...
    def get_logger(self) -> RcutilsLogger: ...
    def get_name(self) -> str: ...
    def get_namespace(self) -> str: ...
    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]: ...
    def get_topic_names_and_types(self, no_demangle: bool = ...) -> list[tuple[str, list[str]]]: ...
    def get_publishers_info_by_topic(self, topic_name: str, no_mangle: bool = ...) -> list[_EndpointInfo]: ...
    def count_publishers(self, topic_name: str) -> int: ...
