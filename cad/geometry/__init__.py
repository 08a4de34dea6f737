"""Solids, meshes, assemblies and plates, and their measurement in their printing pose.

Whether a design can be built is asked in `cad.checks`.
"""
