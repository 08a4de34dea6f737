"""Evolution of printed robots: body and heating gait together, evaluated by the walk of the printed robot.

The evolution of bodies that learn in the paper's scene is in `eldir.evolution`; how one printed robot
moves is in `eldir.built`.
"""
