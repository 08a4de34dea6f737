# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.
# Written by write_message_stubs.py.

from collections.abc import Sequence
from typing import Any, ClassVar

import std_msgs.msg

class DiagnosticArray:
    header: std_msgs.msg.Header
    status: Sequence[DiagnosticStatus]
    def __init__(self, *, header: std_msgs.msg.Header = ..., status: Sequence[DiagnosticStatus] = ...) -> None: ...

class DiagnosticStatus:
    OK: ClassVar[bytes]
    WARN: ClassVar[bytes]
    ERROR: ClassVar[bytes]
    STALE: ClassVar[bytes]
    level: bytes
    name: str
    message: str
    hardware_id: str
    values: Sequence[KeyValue]
    def __init__(self, *, level: bytes = ..., name: str = ..., message: str = ..., hardware_id: str = ..., values: Sequence[KeyValue] = ...) -> None: ...

class KeyValue:
    key: str
    value: str
    def __init__(self, *, key: str = ..., value: str = ...) -> None: ...
