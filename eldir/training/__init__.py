"""How controllers learn: update rules, domain randomisation, fitting a robot's physics to a motion.

Who learns and who survives is decided in `eldir.evolution`; gradients come from `eldir.engine`.
"""
