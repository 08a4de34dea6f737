"""Drive the printed robot of a random body through one gait and plot the height of its marks m1 to m5."""

from pathlib import Path
from tempfile import mkdtemp

import numpy as np
from matplotlib.figure import Figure

import eldir
from eldir.built.gait import Gait, free_lengths

lattice = eldir.Lattice(rows=6, columns=11)
(genotype,) = eldir.random_genotypes(lattice, 1, np.random.default_rng(4), max_active=2)
body = eldir.develop(lattice, genotype)

robot = eldir.built.build(body)  # grams, printed strips, Coulomb friction
gait = Gait(period=20.0, phase=np.linspace(0, 0.5, body.motors), duty=np.full(body.motors, 0.3))
table = free_lengths(gait, cycles=2)  # Joule heat, hysteresis, free length of each motor over time
(motion,) = eldir.built.drive([robot], [table.lengths], table.interval)

marks = eldir.marked_masses(body)
figure = Figure()
axes = figure.subplots()
for number, mass in enumerate(marks, start=1):
    axes.plot(motion.times, 1e3 * motion.positions[:, mass, 1], label=f"m{number}")
axes.set(xlabel="time [s]", ylabel="height [mm]")
axes.legend()
picture = Path(mkdtemp()) / "marks.png"
figure.savefig(picture)
print(f"{len(body.springs)} springs, {body.motors} motors, {1e3 * robot.masses.sum():.0f} g; see {picture}")
