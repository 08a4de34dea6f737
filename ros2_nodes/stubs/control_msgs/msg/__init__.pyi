# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.
# Written by write_message_stubs.py.

from collections.abc import Sequence
from typing import Any, ClassVar

import std_msgs.msg

class DynamicJointState:
    header: std_msgs.msg.Header
    joint_names: Sequence[str]
    interface_values: Sequence[InterfaceValue]
    def __init__(self, *, header: std_msgs.msg.Header = ..., joint_names: Sequence[str] = ..., interface_values: Sequence[InterfaceValue] = ...) -> None: ...

class InterfaceValue:
    interface_names: Sequence[str]
    values: Any
    def __init__(self, *, interface_names: Sequence[str] = ..., values: Any = ...) -> None: ...
