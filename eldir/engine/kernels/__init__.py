"""Compiled code of the closed-loop robots: one step's forces, contact and controller, each with its adjoint.

Not here: the printed robot's code (`eldir.engine.built`) and what runs before or after a launch.
"""
