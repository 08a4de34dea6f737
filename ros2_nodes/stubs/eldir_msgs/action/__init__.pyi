# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.
# Written by write_message_stubs.py.

from collections.abc import Sequence
from typing import Any, ClassVar

import builtin_interfaces.msg
import eldir_msgs.msg

class RunSchedule:
    class Feedback:
        UNKNOWN: ClassVar[int]
        ARMING: ClassVar[int]
        SETTLING: ClassVar[int]
        CONDITIONING: ClassVar[int]
        COUNTING: ClassVar[int]
        stamp: builtin_interfaces.msg.Time
        elapsed: builtin_interfaces.msg.Duration
        phase: int
        cycle: int
        latest_edge: Sequence[eldir_msgs.msg.Edge]
        closed: Any
        springs: Sequence[str]
        temperatures: Any
        def __init__(self, *, stamp: builtin_interfaces.msg.Time = ..., elapsed: builtin_interfaces.msg.Duration = ..., phase: int = ..., cycle: int = ..., latest_edge: Sequence[eldir_msgs.msg.Edge] = ..., closed: Any = ..., springs: Sequence[str] = ..., temperatures: Any = ...) -> None: ...
    class Goal:
        schedule: eldir_msgs.msg.Schedule
        client: str
        def __init__(self, *, schedule: eldir_msgs.msg.Schedule = ..., client: str = ...) -> None: ...
    class Result:
        UNKNOWN: ClassVar[int]
        FINISHED: ClassVar[int]
        CANCELLED: ClassVar[int]
        PREEMPTED: ClassVar[int]
        STOPPED: ClassVar[int]
        REFUSED: ClassVar[int]
        outcome: int
        message: str
        start: builtin_interfaces.msg.Time
        duration: builtin_interfaces.msg.Duration
        peak_temperature: float
        max_delay: builtin_interfaces.msg.Duration
        edges: Sequence[eldir_msgs.msg.Edge]
        all_off: bool
        def __init__(self, *, outcome: int = ..., message: str = ..., start: builtin_interfaces.msg.Time = ..., duration: builtin_interfaces.msg.Duration = ..., peak_temperature: float = ..., max_delay: builtin_interfaces.msg.Duration = ..., edges: Sequence[eldir_msgs.msg.Edge] = ..., all_off: bool = ...) -> None: ...
