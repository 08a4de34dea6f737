"""Drive a printed robot that evolved, with its own gait, and plot the height of its markers m1 to m5."""

from pathlib import Path
from tempfile import mkdtemp

from matplotlib.figure import Figure

import eldir
from eldir.benchmark.built import walkers
from eldir.built.gait import free_lengths

body, gait = walkers()[4]  # one of nine robots that come with the program

robot = eldir.built.build(body)  # grams, printed strips, Coulomb friction
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
walked = 1e3 * (motion.positions[-1] - motion.positions[0])[:, 0].mean()
print(f"{len(body.springs)} springs, {1e3 * robot.masses.sum():.0f} g: walked {walked:.0f} mm; see {picture}")
