"""Solids, meshes, assemblies and plates, and their measurement as the printer sees them.

Whether a design can be built is asked in `cad.checks`.
"""
