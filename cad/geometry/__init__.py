"""Solids, meshes, assemblies and plates, and measurements of parts in their printing pose.

`cad.checks` decides whether a design can be built.
"""
