# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.
# Written by write_message_stubs.py.

from collections.abc import Sequence
from typing import Any, ClassVar

import builtin_interfaces.msg

class Bool:
    data: bool
    def __init__(self, *, data: bool = ...) -> None: ...

class Byte:
    data: bytes
    def __init__(self, *, data: bytes = ...) -> None: ...

class ByteMultiArray:
    layout: MultiArrayLayout
    data: Any
    def __init__(self, *, layout: MultiArrayLayout = ..., data: Any = ...) -> None: ...

class Char:
    data: int
    def __init__(self, *, data: int = ...) -> None: ...

class ColorRGBA:
    r: float
    g: float
    b: float
    a: float
    def __init__(self, *, r: float = ..., g: float = ..., b: float = ..., a: float = ...) -> None: ...

class Empty:
    structure_needs_at_least_one_member: int
    def __init__(self, *, structure_needs_at_least_one_member: int = ...) -> None: ...

class Float32:
    data: float
    def __init__(self, *, data: float = ...) -> None: ...

class Float32MultiArray:
    layout: MultiArrayLayout
    data: Any
    def __init__(self, *, layout: MultiArrayLayout = ..., data: Any = ...) -> None: ...

class Float64:
    data: float
    def __init__(self, *, data: float = ...) -> None: ...

class Float64MultiArray:
    layout: MultiArrayLayout
    data: Any
    def __init__(self, *, layout: MultiArrayLayout = ..., data: Any = ...) -> None: ...

class Header:
    stamp: builtin_interfaces.msg.Time
    frame_id: str
    def __init__(self, *, stamp: builtin_interfaces.msg.Time = ..., frame_id: str = ...) -> None: ...

class Int16:
    data: int
    def __init__(self, *, data: int = ...) -> None: ...

class Int16MultiArray:
    layout: MultiArrayLayout
    data: Any
    def __init__(self, *, layout: MultiArrayLayout = ..., data: Any = ...) -> None: ...

class Int32:
    data: int
    def __init__(self, *, data: int = ...) -> None: ...

class Int32MultiArray:
    layout: MultiArrayLayout
    data: Any
    def __init__(self, *, layout: MultiArrayLayout = ..., data: Any = ...) -> None: ...

class Int64:
    data: int
    def __init__(self, *, data: int = ...) -> None: ...

class Int64MultiArray:
    layout: MultiArrayLayout
    data: Any
    def __init__(self, *, layout: MultiArrayLayout = ..., data: Any = ...) -> None: ...

class Int8:
    data: int
    def __init__(self, *, data: int = ...) -> None: ...

class Int8MultiArray:
    layout: MultiArrayLayout
    data: Any
    def __init__(self, *, layout: MultiArrayLayout = ..., data: Any = ...) -> None: ...

class MultiArrayDimension:
    label: str
    size: int
    stride: int
    def __init__(self, *, label: str = ..., size: int = ..., stride: int = ...) -> None: ...

class MultiArrayLayout:
    dim: Sequence[MultiArrayDimension]
    data_offset: int
    def __init__(self, *, dim: Sequence[MultiArrayDimension] = ..., data_offset: int = ...) -> None: ...

class String:
    data: str
    def __init__(self, *, data: str = ...) -> None: ...

class UInt16:
    data: int
    def __init__(self, *, data: int = ...) -> None: ...

class UInt16MultiArray:
    layout: MultiArrayLayout
    data: Any
    def __init__(self, *, layout: MultiArrayLayout = ..., data: Any = ...) -> None: ...

class UInt32:
    data: int
    def __init__(self, *, data: int = ...) -> None: ...

class UInt32MultiArray:
    layout: MultiArrayLayout
    data: Any
    def __init__(self, *, layout: MultiArrayLayout = ..., data: Any = ...) -> None: ...

class UInt64:
    data: int
    def __init__(self, *, data: int = ...) -> None: ...

class UInt64MultiArray:
    layout: MultiArrayLayout
    data: Any
    def __init__(self, *, layout: MultiArrayLayout = ..., data: Any = ...) -> None: ...

class UInt8:
    data: int
    def __init__(self, *, data: int = ...) -> None: ...

class UInt8MultiArray:
    layout: MultiArrayLayout
    data: Any
    def __init__(self, *, layout: MultiArrayLayout = ..., data: Any = ...) -> None: ...
