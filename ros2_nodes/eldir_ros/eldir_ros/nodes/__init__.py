"""The seven nodes, one a module; each module's `main` is the executable of the same name.

They subscribe, translate with `eldir_ros.conversions`, call the toolkit and publish.
"""
