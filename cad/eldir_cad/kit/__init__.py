"""The kit: dimensions, materials and printers, read from data files.

Solids and meshes are in `eldir_cad.geometry`.
"""
