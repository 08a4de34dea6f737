# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""ROS 2 nodes of a rig: they translate messages; every decision is made by the toolkit below.

`nodes` holds the eight nodes, `programs` what starts them, `base` what they share.
"""

import logging

logging.getLogger(__name__).addHandler(logging.NullHandler())  # programs decide what is written
