"""What is built and on which printer: dimensions and materials, read from data files.

No solids and no meshes (`cad.geometry`).
"""
