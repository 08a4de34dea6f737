"""`python -m benchmarks.headroom DESIGN... --out FILE`: where there is something to learn (decision 78).

Each design stands on virtual rigs with `parameter_spread: large`. How far does the first gait of `eldir
adapt` walk there, and how far the best of all gaits that the rig allows: phases, periods, and a pulse for
each motor? The engine searches with the true robot, MuJoCo decides between the first gait and the best ones.
What more current and longer pulses would bring is the engine's alone. A rig is a line in FILE; those in it
are not computed again.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.hidden_robot import HiddenRig, HiddenRobot, Rows
from eldir.built.gait import Gait
from eldir.built.gait_search import find_gait
from eldir.built.screening import PHASES
from eldir_calibration.adaptation.runs import AdaptationConfig
from eldir_hardware.planning.plan import heating_limits
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety.limits import max_pulse

HEADROOM, MIN_GAIN = 1.1, AdaptationConfig().min_gain
"""There is something to learn where the best gait walks so many times as far as the first one, and farther by
what a run must gain [body lengths per five cycles]."""
PERIODS = (20.0, 25.0, 30.0, 40.0, 60.0)
"""Periods that are tried [s]."""
PULSES = (1.0, 0.75, 0.5)
"""Pulses that are tried, as parts of the longest one that the rig allows with a period."""
MORE_CURRENT = (1.1, 1.25)
"""Multiples of the supply's current that are tried, whatever the limits."""
LONGER = (8.0, 10.0)
"""Pulses that are tried, whatever the limits [s]."""
_REFINED = 3  # gaits with the longest pulses of which neighbours are tried
_FINALISTS = 2  # gaits that MuJoCo plays beside the first one
_CYCLES = 2  # counted cycles there


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.headroom", description=__doc__)
    parser.add_argument("designs", nargs="+", type=Path, metavar="DESIGN")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="JSON lines, a rig in each")
    parser.add_argument("--seeds", nargs="+", type=int, default=[11, 12], help="of the rigs")
    given = parser.parse_args(arguments)
    rows = Rows(given.out)
    print(
        "| design | rig | stroke [mm], used | first gait | best gait | it is | in the engine: first, best "
        "| 10, 25 % more current | pulses of 8, 10 s |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for design_file, seed in product((file.resolve() for file in given.designs), given.seeds):
        row = rows.find(design_file, seed)
        if row is None:
            row = Search(design_file, seed, given.out.parent / f"rig-{seed}").row()
            rows.add(row)
        print(_describe(row), flush=True)
    every = rows.read()
    learnable = sum(row["best"] >= max(HEADROOM * row["first"], row["first"] + MIN_GAIN) for row in every)
    print(f"\n{learnable} of {len(every)} rigs: a gait walks {HEADROOM:g} times as far as the first one.")


@dataclass(frozen=True)
class Search(HiddenRig):
    """The gaits of a robot on a hidden rig."""

    @cached_property
    def robot(self) -> HiddenRobot:
        """The robot on the rig."""
        return HiddenRobot(self.design, self.rig)

    def row(self) -> dict[str, Any]:
        """The first gait, the best ones, and what heat would bring."""
        first = find_gait(self.design, heating_limits(self.rig), samples=2).gait
        tried = self.search()
        finalists = [gait for gait, _ in tried[:_FINALISTS]]
        walks = [self.robot.walk(gait, _CYCLES) for gait in (first, *finalists)]
        best = int(np.argmax(walks))
        used, stroke = self.robot.stroke(first)
        return {
            "design": str(self.design_file),
            "seed": self.seed,
            "stroke_m": stroke,
            "stroke_used": used,
            "first": walks[0],
            "first_gait": first.to_json(),
            "first_in_engine": float(self.robot.engine_walks([first])[0]),
            "best": walks[best],
            "best_gait": (first, *finalists)[best].to_json(),
            "best_in_engine": tried[0][1],
            "finalists": walks[1:],
            "more_current": [self._best_usual(replace(self.robot, current=c), 6.0) for c in MORE_CURRENT],
            "longer": [self._best_usual(self.robot, pulse) for pulse in LONGER],
        }

    def search(self) -> list[tuple[Gait, float]]:
        """Gaits with their walks in the engine, from the best one on: all phases with the longest pulses of
        each period; then the best of each two others, other pulses of each motor, and phases between."""
        motors = self.design.morphology.motors
        longest = {period: max_pulse_in_period(self.rig, period) for period in PERIODS}
        whole = [
            make_gait(period, phase / PHASES, [pulse] * motors)
            for period, pulse in longest.items()
            for phase in range(PHASES if motors > 1 else 1)
            if pulse > 0
        ]
        found = self._ranked(whole)
        more: list[Gait] = []
        for gait, _ in found[:_REFINED]:
            pulse, phase = longest[gait.period], float(gait.phase[-1])
            parts = [one for one in product(PULSES, repeat=motors) if min(one) < 1]
            more += [make_gait(gait.period, phase, [part * pulse for part in one]) for one in parts]
            if motors > 1:
                between = [phase + by / PHASES for by in (-0.5, 0.5)]
                more += [make_gait(gait.period, p % 1.0, [pulse] * motors) for p in between]
        return sorted(found + self._ranked(more), key=lambda one: -one[1])

    def _ranked(self, gaits: Sequence[Gait]) -> list[tuple[Gait, float]]:
        walks = self.robot.engine_walks(gaits)
        return sorted(zip(gaits, walks.tolist(), strict=True), key=lambda one: -one[1])

    def _best_usual(self, robot: HiddenRobot, pulse: float) -> float:
        """The best walk in the engine of all phases with this pulse in 30 and in 40 s."""
        motors = self.design.morphology.motors
        gaits = [
            make_gait(period, phase / PHASES, [pulse] * motors)
            for period, phase in product((30.0, 40.0), range(PHASES if motors > 1 else 1))
        ]
        return float(robot.engine_walks(gaits).max())


def make_gait(period: float, phase: float, pulses: Sequence[float]) -> Gait:
    """A gait with these pulses [s], whose second motor is `phase` of a period later."""
    phases = np.array([0.0, phase][: len(pulses)])
    return Gait(period, phases, np.array(pulses) / period)


def max_pulse_in_period(rig: Rig, period: float) -> float:
    """The longest pulse of all motors that a rig allows in a period, in steps of a tenth of a second [s]; 0
    if it allows none."""
    allowed = heating_limits(rig).allowed
    tenths = range(int(10 * max_pulse(rig) + 1e-6), 9, -1)
    gaits = (Gait(period, np.array([0.0]), np.array([t / 10 / period])) for t in tenths)
    return next((float(gait.duty[0] * period) for gait in gaits if allowed(gait)), 0.0)


def _describe(row: dict[str, Any]) -> str:
    gait = Gait.from_json(row["best_gait"])
    pulses = " and ".join(f"{pulse:.1f}" for pulse in gait.duty * gait.period)
    what = f"{pulses} s in {gait.period:g} s, phase {(gait.phase[-1] - gait.phase[0]) % 1:.2f}"
    stroke = f"{1e3 * row['stroke_m']:.0f}, {row['stroke_used']:.0%}"
    heat = [", ".join(f"{walk:+.2f}" for walk in row[name]) for name in ("more_current", "longer")]
    return (
        f"| {row['design']} | {row['seed']} | {stroke} | {row['first']:+.2f} | {row['best']:+.2f} | {what} "
        f"| {row['first_in_engine']:+.2f}, {row['best_in_engine']:+.2f} | {' | '.join(heat)} |"
    )


if __name__ == "__main__":
    main()
