# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.
# Written by write_message_stubs.py.

from collections.abc import Sequence
from typing import Any, ClassVar

import builtin_interfaces.msg

class FloatingPointRange:
    from_value: float
    to_value: float
    step: float
    def __init__(self, *, from_value: float = ..., to_value: float = ..., step: float = ...) -> None: ...

class IntegerRange:
    from_value: int
    to_value: int
    step: int
    def __init__(self, *, from_value: int = ..., to_value: int = ..., step: int = ...) -> None: ...

class ListParametersResult:
    names: Sequence[str]
    prefixes: Sequence[str]
    def __init__(self, *, names: Sequence[str] = ..., prefixes: Sequence[str] = ...) -> None: ...

class Log:
    DEBUG: ClassVar[int]
    INFO: ClassVar[int]
    WARN: ClassVar[int]
    ERROR: ClassVar[int]
    FATAL: ClassVar[int]
    stamp: builtin_interfaces.msg.Time
    level: int
    name: str
    msg: str
    file: str
    function: str
    line: int
    def __init__(self, *, stamp: builtin_interfaces.msg.Time = ..., level: int = ..., name: str = ..., msg: str = ..., file: str = ..., function: str = ..., line: int = ...) -> None: ...

class LoggerLevel:
    LOG_LEVEL_UNKNOWN: ClassVar[int]
    LOG_LEVEL_DEBUG: ClassVar[int]
    LOG_LEVEL_INFO: ClassVar[int]
    LOG_LEVEL_WARN: ClassVar[int]
    LOG_LEVEL_ERROR: ClassVar[int]
    LOG_LEVEL_FATAL: ClassVar[int]
    name: str
    level: int
    def __init__(self, *, name: str = ..., level: int = ...) -> None: ...

class Parameter:
    name: str
    value: ParameterValue
    def __init__(self, *, name: str = ..., value: ParameterValue = ...) -> None: ...

class ParameterDescriptor:
    name: str
    type: int
    description: str
    additional_constraints: str
    read_only: bool
    dynamic_typing: bool
    floating_point_range: Sequence[FloatingPointRange]
    integer_range: Sequence[IntegerRange]
    def __init__(self, *, name: str = ..., type: int = ..., description: str = ..., additional_constraints: str = ..., read_only: bool = ..., dynamic_typing: bool = ..., floating_point_range: Sequence[FloatingPointRange] = ..., integer_range: Sequence[IntegerRange] = ...) -> None: ...

class ParameterEvent:
    stamp: builtin_interfaces.msg.Time
    node: str
    new_parameters: Sequence[Parameter]
    changed_parameters: Sequence[Parameter]
    deleted_parameters: Sequence[Parameter]
    def __init__(self, *, stamp: builtin_interfaces.msg.Time = ..., node: str = ..., new_parameters: Sequence[Parameter] = ..., changed_parameters: Sequence[Parameter] = ..., deleted_parameters: Sequence[Parameter] = ...) -> None: ...

class ParameterEventDescriptors:
    new_parameters: Sequence[ParameterDescriptor]
    changed_parameters: Sequence[ParameterDescriptor]
    deleted_parameters: Sequence[ParameterDescriptor]
    def __init__(self, *, new_parameters: Sequence[ParameterDescriptor] = ..., changed_parameters: Sequence[ParameterDescriptor] = ..., deleted_parameters: Sequence[ParameterDescriptor] = ...) -> None: ...

class ParameterType:
    PARAMETER_NOT_SET: ClassVar[int]
    PARAMETER_BOOL: ClassVar[int]
    PARAMETER_INTEGER: ClassVar[int]
    PARAMETER_DOUBLE: ClassVar[int]
    PARAMETER_STRING: ClassVar[int]
    PARAMETER_BYTE_ARRAY: ClassVar[int]
    PARAMETER_BOOL_ARRAY: ClassVar[int]
    PARAMETER_INTEGER_ARRAY: ClassVar[int]
    PARAMETER_DOUBLE_ARRAY: ClassVar[int]
    PARAMETER_STRING_ARRAY: ClassVar[int]
    structure_needs_at_least_one_member: int
    def __init__(self, *, structure_needs_at_least_one_member: int = ...) -> None: ...

class ParameterValue:
    type: int
    bool_value: bool
    integer_value: int
    double_value: float
    string_value: str
    byte_array_value: Any
    bool_array_value: Any
    integer_array_value: Any
    double_array_value: Any
    string_array_value: Sequence[str]
    def __init__(self, *, type: int = ..., bool_value: bool = ..., integer_value: int = ..., double_value: float = ..., string_value: str = ..., byte_array_value: Any = ..., bool_array_value: Any = ..., integer_array_value: Any = ..., double_array_value: Any = ..., string_array_value: Sequence[str] = ...) -> None: ...

class SetLoggerLevelsResult:
    successful: bool
    reason: str
    def __init__(self, *, successful: bool = ..., reason: str = ...) -> None: ...

class SetParametersResult:
    successful: bool
    reason: str
    def __init__(self, *, successful: bool = ..., reason: str = ...) -> None: ...
