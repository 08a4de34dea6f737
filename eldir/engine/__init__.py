"""The simulation on all cores: kernels, packing and launches; the only room that knows Taichi.

What is simulated is described outside (`eldir.scene`, `eldir.morphology`, `eldir.built`).
"""
