# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The eight nodes, one a module; each module's `main` is the executable of the same name.

They subscribe, translate with `eldir_ros.conversions`, call the toolkit and publish.
"""
