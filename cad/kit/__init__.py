"""The kit: dimensions, materials and printers, read from data files.

No solids and no meshes (`cad.geometry`).
"""
