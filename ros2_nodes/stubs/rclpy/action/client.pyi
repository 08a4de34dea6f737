# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

from rclpy.task import Future

class ClientGoalHandle:
    @property
    def accepted(self) -> bool: ...
    def cancel_goal_async(self) -> Future: ...
    def get_result_async(self) -> Future: ...
