# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.
# Written by write_message_stubs.py.

from collections.abc import Sequence
from typing import Any, ClassVar

import builtin_interfaces.msg
import geometry_msgs.msg
import lifecycle_msgs.msg
import std_msgs.msg

class BoardState:
    header: std_msgs.msg.Header
    age: builtin_interfaces.msg.Duration
    run: str
    sequence: int
    armed: bool
    channels: Sequence[str]
    closed: Any
    springs: Sequence[str]
    temperatures: Any
    currents: Any
    voltages: Any
    peak_temperature: float
    max_delay: builtin_interfaces.msg.Duration
    def __init__(self, *, header: std_msgs.msg.Header = ..., age: builtin_interfaces.msg.Duration = ..., run: str = ..., sequence: int = ..., armed: bool = ..., channels: Sequence[str] = ..., closed: Any = ..., springs: Sequence[str] = ..., temperatures: Any = ..., currents: Any = ..., voltages: Any = ..., peak_temperature: float = ..., max_delay: builtin_interfaces.msg.Duration = ...) -> None: ...

class Edge:
    elapsed: builtin_interfaces.msg.Duration
    channel: int
    closed: bool
    def __init__(self, *, elapsed: builtin_interfaces.msg.Duration = ..., channel: int = ..., closed: bool = ...) -> None: ...

class EmergencyStop:
    stamp: builtin_interfaces.msg.Time
    stopped: bool
    reason: str
    def __init__(self, *, stamp: builtin_interfaces.msg.Time = ..., stopped: bool = ..., reason: str = ...) -> None: ...

class Heartbeat:
    stamp: builtin_interfaces.msg.Time
    name: str
    state: lifecycle_msgs.msg.State
    def __init__(self, *, stamp: builtin_interfaces.msg.Time = ..., name: str = ..., state: lifecycle_msgs.msg.State = ...) -> None: ...

class HeatCommand:
    UNKNOWN: ClassVar[int]
    KEEPALIVE: ClassVar[int]
    PULSES: ClassVar[int]
    ABORT: ClassVar[int]
    END_OF_RUN: ClassVar[int]
    command: int
    run: str
    sequence: int
    delay: builtin_interfaces.msg.Duration
    pulses: Sequence[Pulse]
    def __init__(self, *, command: int = ..., run: str = ..., sequence: int = ..., delay: builtin_interfaces.msg.Duration = ..., pulses: Sequence[Pulse] = ...) -> None: ...

class MotionPlane:
    header: std_msgs.msg.Header
    height: int
    width: int
    homography: Any
    centre: Any
    radial: Any
    rms: float
    source: str
    version: str
    date: str
    expiry: str
    remark: str
    pictures: int
    visible_tags: Any
    tags: ReferenceTags
    def __init__(self, *, header: std_msgs.msg.Header = ..., height: int = ..., width: int = ..., homography: Any = ..., centre: Any = ..., radial: Any = ..., rms: float = ..., source: str = ..., version: str = ..., date: str = ..., expiry: str = ..., remark: str = ..., pictures: int = ..., visible_tags: Any = ..., tags: ReferenceTags = ...) -> None: ...

class Pulse:
    channel: int
    duration: builtin_interfaces.msg.Duration
    def __init__(self, *, channel: int = ..., duration: builtin_interfaces.msg.Duration = ...) -> None: ...

class RangeOfMotion:
    header: std_msgs.msg.Header
    cycle: int
    markers: Sequence[str]
    simulated: Any
    predicted: Any
    tracked: Any
    displacement: float
    def __init__(self, *, header: std_msgs.msg.Header = ..., cycle: int = ..., markers: Sequence[str] = ..., simulated: Any = ..., predicted: Any = ..., tracked: Any = ..., displacement: float = ...) -> None: ...

class ReferenceTag:
    id: int
    position: geometry_msgs.msg.Point
    def __init__(self, *, id: int = ..., position: geometry_msgs.msg.Point = ...) -> None: ...

class ReferenceTags:
    header: std_msgs.msg.Header
    dictionary: str
    side: float
    tags: Sequence[ReferenceTag]
    def __init__(self, *, header: std_msgs.msg.Header = ..., dictionary: str = ..., side: float = ..., tags: Sequence[ReferenceTag] = ...) -> None: ...

class RigDigest:
    section: str
    digest: str
    def __init__(self, *, section: str = ..., digest: str = ...) -> None: ...

class Run:
    UNKNOWN: ClassVar[int]
    RUNNING: ClassVar[int]
    FINISHED: ClassVar[int]
    ENDED: ClassVar[int]
    state: int
    id: str
    start: builtin_interfaces.msg.Time
    schedule: Schedule
    message: str
    room_temperature: Any
    def __init__(self, *, state: int = ..., id: str = ..., start: builtin_interfaces.msg.Time = ..., schedule: Schedule = ..., message: str = ..., room_temperature: Any = ...) -> None: ...

class Schedule:
    period: builtin_interfaces.msg.Duration
    cycles: int
    conditioning_cycles: int
    settle: builtin_interfaces.msg.Duration
    springs: Any
    events: Sequence[ScheduleEvent]
    origin: ScheduleOrigin
    def __init__(self, *, period: builtin_interfaces.msg.Duration = ..., cycles: int = ..., conditioning_cycles: int = ..., settle: builtin_interfaces.msg.Duration = ..., springs: Any = ..., events: Sequence[ScheduleEvent] = ..., origin: ScheduleOrigin = ...) -> None: ...

class ScheduleEvent:
    FRONT: ClassVar[int]
    BACK: ClassVar[int]
    BOTH: ClassVar[int]
    time: builtin_interfaces.msg.Duration
    spring: int
    face: int
    channel: int
    closed: bool
    def __init__(self, *, time: builtin_interfaces.msg.Duration = ..., spring: int = ..., face: int = ..., channel: int = ..., closed: bool = ...) -> None: ...

class ScheduleOrigin:
    version: str
    rig: str
    design: str
    seed: Any
    plan_digest: str
    design_digest: str
    scene_digest: str
    wiring_digest: str
    rig_digests: Sequence[RigDigest]
    def __init__(self, *, version: str = ..., rig: str = ..., design: str = ..., seed: Any = ..., plan_digest: str = ..., design_digest: str = ..., scene_digest: str = ..., wiring_digest: str = ..., rig_digests: Sequence[RigDigest] = ...) -> None: ...
