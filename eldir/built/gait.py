"""Gaits: when each motor heats within a period, the free lengths that result, and films of gaits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from pydantic import Field

from eldir.built.heat import SpringState, heat, join_hubs
from eldir.core.arguments import require_count, require_value, require_whole_number
from eldir.core.records import OMITTED, Array, BoolArray, FloatArray, IntArray, Record, record
from eldir.core.validation import validate
from eldir.design import Design
from eldir.parameters.springs import SpringParameters
from eldir.parameters.wiring import FACES
from eldir.rollout import Rollout
from eldir.scene import Scene

PERIOD = 30.0
"""Usual period [s]: long enough to heat past Af and to cool below Mf with the fan, also in a warm room, and
to allow the rig of the template its current (decision 58)."""
DUTY = 0.2
SETTLE = 3.0
"""Rest before the first cycle [s]."""
CONDITIONING = 1
"""Cycles before those that are measured, until temperatures repeat."""
CYCLES = 5
"""Cycles that are measured (paper, Sect. Sim2Real)."""
_HIGH, _LOW = 0.2, -0.2  # Schmitt thresholds on the activation, of half its range
_SAMPLES = 100  # of a period, when activations are folded onto it
_SAME = 1e-4  # of a period: schedules are rounded to milliseconds
_NEAR_PHASE = 0.1  # of a period: less than a step of the searched phases
_NEAR_TIME = 0.1  # relative
_WALK = 0.1  # body lengths per five cycles: less counts as standing still


@record
class Gait(Record):
    """One heating phase for each of A motors in a common period."""

    OPTIONAL = frozenset()

    period: Annotated[float, Field(gt=0, alias="period_s")]
    """Period of the gait [s]."""
    phase: Annotated[FloatArray, Array("f8", None)]
    """Start of heating of each motor, as a part of the period, shape (A,)."""
    duty: Annotated[FloatArray, Array("f8", None)]
    """Duration of heating of each motor, as a part of the period, shape (A,); 0: never."""
    method: str = "search"
    """How the gait was found: search, phases searched with the built robot; imitate, phases of the
    closed-loop rollout; evolved, with the body."""

    def __post_init__(self) -> None:
        if self.duty.shape != self.phase.shape or not ((self.duty >= 0) & (self.duty < 1)).all():
            motors = len(self.phase)
            raise ValueError(f"invalid duty: expected {motors} values in [0, 1), found {self.duty.tolist()}")

    def is_near(self, other: Gait) -> bool:
        """Whether another gait of the same robot differs so little that a film of it would tell nothing new:
        phases relative to the first motor by less than a tenth of the period, period and times of heating by
        less than a tenth of themselves."""
        shift = (self.phase - self.phase[0]) - (other.phase - other.phase[0])
        times, others = (np.append(g.duty, 1.0) * g.period for g in (self, other))
        return bool(
            (np.abs((shift + 0.5) % 1.0 - 0.5) < _NEAR_PHASE).all()
            and (np.abs(times - others) < _NEAR_TIME * np.maximum(times, others) + _SAME).all()
        )

    def is_heating(self, times: FloatArray) -> BoolArray:
        """Whether each motor heats at `times` since the start of the first cycle [s], shape (T, A)."""
        cycle = np.asarray(times)[:, None] / self.period
        return ((cycle - self.phase) % 1.0 < self.duty) & (cycle >= 0)

    @classmethod
    def from_rollout(cls, rollout: Rollout, scene: Scene, period: float = PERIOD) -> Gait:
        """The closed-loop behaviour, folded onto the period of the pattern generators and stretched to
        `period` [s].

        Each activation is averaged over the cycles after the first. A Schmitt trigger (thresholds 0.2 and
        -0.2 of half its range, about the middle of that) turns it on or off. The longest on-phase is kept,
        cut to the springs' duty of 0.3. Springs are heated fully even where a controller uses a part of a
        motor's range: a contact is open or closed.
        """
        cpg = 2 * np.pi / scene.omega
        t = np.arange(len(rollout.activations)) * scene.dt
        grid = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
        phase, duty = [], []
        for activation in rollout.activations.T:
            late = t >= min(cpg, t[-1] / 2)
            bins = ((t[late] / cpg) % 1.0 * _SAMPLES).astype(int)
            count = np.maximum(np.bincount(bins, minlength=_SAMPLES), 1)
            folded = np.bincount(bins, activation[late], minlength=_SAMPLES) / count
            start, length = _longest_on(_schmitt(folded - (folded.max() + folded.min()) / 2))
            phase.append(grid[start] - 0.5 / _SAMPLES)
            duty.append(min(length / _SAMPLES, DUTY))
        return cls(period, np.array(phase), np.array(duty), "imitate")


def read_gait(design: Design) -> Gait | None:
    """The gait that a design carries, evolved with it or found by `eldir shortlist`; None if there is none.

    Raises `InputError` if it is damaged or does not fit the design's motors.
    """
    values = design.provenance.get("gait")
    if values is None:
        return None
    gait = validate(Gait, values, "the design's gait", "run eldir shortlist again")
    require_count("phases in the design's gait", len(gait.phase), design.morphology.motors, "motor")
    return gait


def _schmitt(signal: FloatArray) -> BoolArray:
    """Schmitt trigger: on above the high threshold until below the low one; both are fractions of the largest
    excursion."""
    top = float(np.abs(signal).max())
    if top == 0:
        return np.zeros(len(signal), bool)
    state, states = False, []
    for value in np.tile(signal / top, 2):  # the second pass starts in the right state
        state = value > _HIGH if not state else value > _LOW
        states.append(state)
    return np.array(states[len(signal) :])


def _longest_on(on: BoolArray) -> tuple[int, int]:
    """Start and length of the longest cyclic run of True."""
    if on.all() or not on.any():
        return 0, len(on) if on.all() else 0
    turned = np.roll(on, -int(np.flatnonzero(~on)[0]))
    edges = np.diff(np.concatenate([[0], turned.astype(int), [0]]))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    longest = int((ends - starts).argmax())
    first = int(np.flatnonzero(~on)[0])
    return int((starts[longest] + first) % len(on)), int((ends - starts)[longest])


@dataclass(frozen=True, eq=False)
class FreeLengths(Record):
    """Free lengths of heated springs over time, as `eldir.built.motion.drive` takes them."""

    interval: float
    """Time between two rows [s]."""
    lengths: FloatArray
    """Free lengths [m], shape (K + 1, A)."""
    temperatures: FloatArray
    """Temperatures [C], shape (K, A)."""
    first_cycle: int
    """Row of `lengths` at which the first cycle that counts begins."""


def free_lengths(
    gait: Gait,
    springs: SpringParameters | Sequence[SpringParameters] | None = None,
    cycles: int = CYCLES,
    conditioning: int = CONDITIONING,
    interval: float = 0.05,
    hubs: IntArray | None = None,
) -> FreeLengths:
    """Free lengths of springs that are heated by a gait: a settling time, conditioning cycles, then `cycles`
    that count.

    `springs`: one for all motors, or one for each; by default nominal ones. `interval` [s] is the time
    between two rows of the table. `hubs` of each motor: see `heat`. Raises `InputError` for a number of
    springs that does not fit the gait, a number of cycles that is not whole, and an interval that is not
    positive.
    """
    if not isinstance(springs, Sequence):
        springs = [springs or SpringParameters()] * len(gait.phase)
    return free_lengths_batch(
        [(gait, springs)], cycles, conditioning, interval, hubs=None if hubs is None else [hubs]
    )[0]


def heat_faces(
    gait: Gait, springs: Sequence[SpringParameters], cycles: int = CYCLES, hubs: IntArray | None = None
) -> FreeLengths:
    """Free lengths of each spring of both faces, in the order front and back of the first motor, front and
    back of the second: shape (K, 2A). `springs`: in the same order. `hubs` of each motor, shape (A, 2): heat
    passes between springs of one face."""
    faces = len(FACES)
    both = Gait(gait.period, np.repeat(gait.phase, faces), np.repeat(gait.duty, faces))
    if hubs is not None:  # each face has its own
        hubs = join_hubs([hubs] * faces).reshape(faces, -1, 2).swapaxes(0, 1).reshape(-1, 2)
    return free_lengths(both, springs, cycles, hubs=hubs)


def free_lengths_batch(
    robots: Sequence[tuple[Gait, Sequence[SpringParameters]]],
    cycles: int = CYCLES,
    conditioning: int = CONDITIONING,
    interval: float = 0.05,
    *,
    many: bool = False,
    hubs: Sequence[IntArray] | None = None,
    power_shares: Sequence[float] = (),
) -> list[FreeLengths]:
    """`free_lengths` of many gaits, each with the spring of each motor; all are heated side by side. `many`,
    and the `hubs` of each robot: see `heat`. `power_shares`: power of a spring while n springs of a robot
    heat, relative to its power alone, for n = 0, 1, ..., two springs for each motor; empty: always 1."""
    if not robots:
        return []
    cycles, conditioning = (
        require_whole_number("cycles", cycles, 0),
        require_whole_number("conditioning", conditioning, 0),
    )
    require_value("interval", 0 < interval < np.inf, "more than 0 s", interval)
    for gait, own in robots:
        require_count("phases in the gait", len(gait.phase), len(own), "spring that it heats")
    if hubs is not None:
        require_count("hubs", len(hubs), len(robots))
    ends = [round((SETTLE + gait.period * (cycles + conditioning)) / interval) for gait, _ in robots]
    every = [p for _, own in robots for p in own]
    on = np.zeros((max(ends), len(every)))
    starts = np.arange(max(ends)) * interval - SETTLE + 1e-9
    last = np.cumsum([len(own) for _, own in robots])
    for (gait, own), end, column in zip(robots, ends, last, strict=True):
        heating = gait.is_heating(starts[:end])
        power = np.asarray(power_shares)[len(FACES) * heating.sum(axis=1)][:, None] if power_shares else 1.0
        on[:end, column - len(own) : column] = heating * power
    state = SpringState(np.array([p.ambient for p in every]), np.ones(len(every)))
    joined = None if hubs is None else join_hubs(hubs)
    history = heat(on, interval, every, state, many=many, hubs=joined)
    lengths = np.concatenate([[[p.cold_length for p in every]], history.length])
    return [
        FreeLengths(
            interval,
            lengths[: end + 1, column - len(own) : column].copy(),
            history.temperature[:end, column - len(own) : column].copy(),
            round((SETTLE + conditioning * gait.period) / interval),
        )
        for (gait, own), end, column in zip(robots, ends, last, strict=True)
    ]


def describe_loss(lost_at_s: float) -> str:
    """How a film ended whose markers all vanished, without a sign of a fall, at this time [s]."""
    return f"lost at {lost_at_s:.0f} s: fell, left the picture or was covered"


@record
class FilmedGait(Record):
    """A gait, and the walk that was filmed with it."""

    log: str
    """File name of the log."""
    period_s: Annotated[float, Field(gt=0)]
    """Period of the gait [s]."""
    phase: Annotated[FloatArray, Array("f8", None)]
    """Start of heating of each motor, as a part of the period."""
    duty: Annotated[FloatArray, Array("f8", None)]
    """Duration of heating of each motor, as a part of the period."""
    cycles: Annotated[int, Field(ge=1)]
    """Number of complete cycles in the film in which the walk is known."""
    walked: Annotated[float, Field(alias="body_lengths_per_5_cycles")]
    """Displacement that the camera measured [body lengths per five cycles]."""
    upright: bool
    """Whether the robot was seen upright to the end: in all, its markers were rotated by more than 45 degrees
    for less than a second, and they did not all vanish."""
    lost_at_s: Annotated[Annotated[float, Field(ge=0)] | None, OMITTED] = None
    """When all markers vanished for good without a sign of a fall [s since the start of the run]: the robot
    fell, left the picture or was covered. Missing where they did not, and in older files."""

    def __post_init__(self) -> None:
        _ = self.gait  # which refuses what is no gait

    @classmethod
    def of(
        cls,
        gait: Gait,
        walked: float,
        fell: bool,
        cycles: int,
        log: str,
        lost_at_s: float | None = None,
    ) -> FilmedGait:
        """The film of a gait."""
        upright = not fell and lost_at_s is None
        return cls(log, gait.period, gait.phase, gait.duty, cycles, walked, upright, lost_at_s)

    @cached_property
    def gait(self) -> Gait:
        """The gait that was filmed."""
        return Gait(self.period_s, self.phase, self.duty)

    @property
    def has_fallen(self) -> bool:
        """Whether the film shows a fall."""
        return not self.upright and self.lost_at_s is None

    @property
    def has_walked(self) -> bool:
        """Whether the robot went forward without a fall that was seen."""
        return not self.has_fallen and self.walked >= _WALK

    @property
    def summary(self) -> str:
        """The measured displacement, in one line."""
        how = f"{self.walked:+.2f} body lengths per five cycles"
        if self.lost_at_s is not None:
            return f"{how} over {self.cycles} cycles, {describe_loss(self.lost_at_s)}"
        return f"{how}, upright" if self.upright else f"{how}, and it fell"

    def shows(self, gait: Gait) -> bool:
        """Whether the film shows this gait, up to the rounding of a schedule."""
        mine, other = (
            np.concatenate([[1e-3 * g.period], (g.phase + 0.5 * _SAME) % 1, g.duty])
            for g in (self.gait, gait)
        )
        return bool(np.allclose(mine, other, rtol=0, atol=_SAME))
