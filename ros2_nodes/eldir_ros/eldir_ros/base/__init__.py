# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The common base of the nodes: lifecycle, parameters, message classes, qualities of service, spinning.

The only modules besides the nodes and the programs that import rclpy.
"""
