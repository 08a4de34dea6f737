"""The kit: dimensions, materials and printers, read from data files.

Solids and meshes are in `eldir_cad.geometry`.
"""

PRINTER = "xip"
"""Name of the default printer profile; commands read it without importing more."""
