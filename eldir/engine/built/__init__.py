"""Compiled code of the printed robot: strips, shape-memory springs, Coulomb friction, tangents of the motion.

Not here: how a printed robot is described (`eldir.built.robot`) and its parameters (`eldir.parameters`).
"""
