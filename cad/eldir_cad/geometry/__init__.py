"""Solids, meshes, assemblies and plates, and measurements of parts in their printing pose.

`eldir_cad.checks` decides whether a design can be built.
"""
