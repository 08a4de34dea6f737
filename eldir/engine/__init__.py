"""The simulation engine's host side: packs robots into arrays, launches compiled kernels, unpacks results.

Not here: compiled code (`kernels`, `built`) and the description of what is simulated (`eldir.scene`,
`eldir.morphology`, `eldir.built`).
"""
