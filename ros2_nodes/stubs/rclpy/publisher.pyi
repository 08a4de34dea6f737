# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

from typing import Generic, TypeVar

_Message = TypeVar("_Message")

class Publisher(Generic[_Message]):
    def publish(self, msg: _Message | bytes) -> None: ...
    def get_subscription_count(self) -> int: ...
