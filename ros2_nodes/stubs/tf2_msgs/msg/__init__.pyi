# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.
# Written by write_message_stubs.py.

from collections.abc import Sequence
from typing import Any, ClassVar

import geometry_msgs.msg

class TF2Error:
    NO_ERROR: ClassVar[int]
    LOOKUP_ERROR: ClassVar[int]
    CONNECTIVITY_ERROR: ClassVar[int]
    EXTRAPOLATION_ERROR: ClassVar[int]
    INVALID_ARGUMENT_ERROR: ClassVar[int]
    TIMEOUT_ERROR: ClassVar[int]
    TRANSFORM_ERROR: ClassVar[int]
    error: int
    error_string: str
    def __init__(self, *, error: int = ..., error_string: str = ...) -> None: ...

class TFMessage:
    transforms: Sequence[geometry_msgs.msg.TransformStamped]
    def __init__(self, *, transforms: Sequence[geometry_msgs.msg.TransformStamped] = ...) -> None: ...
