"""Search the gait with which a printed robot walks farthest, and see how certain the walk is."""

import numpy as np

import eldir
from eldir.built.samples import NominalRobots, sample_walks
from eldir.built.screening import candidate_gaits, screen
from eldir.parameters.robot import RobotParameters

# Random bodies with two motors; the few that stand and walk are found by a screening with soft strips.
lattice = eldir.Lattice(rows=4, columns=7)
genotypes = eldir.random_genotypes(lattice, 24, np.random.default_rng(5), max_active=2)
bodies = [eldir.develop(lattice, g) for g in genotypes]
bodies = [body for body in bodies if body.motors == 2]
best = max(screen(bodies, phases=4), key=lambda found: found.best)
body = bodies[best.index]

# All relative phases of the two motors, with the strips' real stiffness; the robots move side by side.
gaits = candidate_gaits(body.motors)
walks = eldir.built.walk([eldir.built.build(body)] * len(gaits), gaits)
for gait, walked in zip(gaits, walks, strict=True):
    print(f"phase {gait.phase[1]:.3f}: {walked:+.2f} body lengths per five cycles")

# The best gait once more, with robots that differ as printed robots do.
(samples,) = sample_walks(NominalRobots(body, RobotParameters()), [gaits[int(np.argmax(walks))]], 8, seed=1)
print(f"eight samples: {samples.mean:+.2f} +- {samples.spread:.2f}, {samples.fallen:.0%} fall")
