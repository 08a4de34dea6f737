# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Names of frames on the graph."""

from __future__ import annotations

from rclpy.node import Node


def frame_name(node: Node, name: str) -> str:
    """Name of one of our frames on the graph: a rig's namespace is its prefix, such as left/ground."""
    return f"{node.get_namespace()}/{name}".lstrip("/")
