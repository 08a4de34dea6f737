"""All parameters of one printed robot: common ones, and those of its single strips and springs.

Beside the parameters of `eldir.parameters.uncertain`, which change all parts of a kind, every strip has a
length of its own, and the springs of the motors differ from each other. The springs' differences are
contrasts: their mean is zero, so that the common parameters remain the mean. `QUANTITIES` are the physical
quantities that results list of a robot.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from eldir.core.arguments import require_count, require_known, require_value
from eldir.core.records import FloatArray, Record
from eldir.core.validation import field_texts
from eldir.morphology import Morphology
from eldir.parameters.printed import STRIP_SPREAD, BuiltParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.tolerances import RigTolerances
from eldir.parameters.uncertain import LISTED, PARAMETERS
from eldir.parameters.wiring import FACES

FOOT_SPREAD = 0.1
"""Standard deviation of the logarithm of a foot's friction, from foot to foot of one robot. Assumed:
repeated measurements of one pair of materials scatter by 5 to 20 per cent (docs/reference/built.md)."""
SPRING_SPREADS = {n: p.between_springs for n, p in PARAMETERS.items() if p.between_springs is not None}
"""Parameters in which the springs of one robot differ, with the standard deviation of the logarithm (of
temperatures [K]). Sources: 1.5 mm of length; contacts and leads; the place in the fan's stream; the wire's
composition."""
_MIN_STROKE = 1e-3  # [m]
_STRIP, _SPRING = "strip", "spring"


@dataclass(frozen=True, eq=False)
class RobotParameters(Record):
    """Parameters of one printed robot; by default the nominal one, in which all parts of a kind are equal."""

    printed: BuiltParameters = field(default_factory=BuiltParameters)
    springs: SpringParameters = field(default_factory=SpringParameters)
    """Mean parameters of the springs of its motors."""
    strips: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Difference of every strip's length from the drawing [m], shape (S,), 0 for active springs. Empty: no
    differences."""
    motor_names: tuple[str, ...] = ()
    """Names of the D parameters in which the springs of the motors differ."""
    motor_z: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """Difference of each motor's spring from `springs`, in standard deviations of the parameters' priors,
    shape (D, A)."""
    feet: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Friction of every mass as a multiple of `printed.friction`, shape (M,). Empty: 1."""
    own_springs: tuple[SpringParameters, ...] = ()
    """The spring of each motor, A of them, where each was sampled separately. Empty: as the other fields
    say."""

    def __post_init__(self) -> None:
        self._set_array("strips", np.float64, (None,))
        self._set_array("feet", np.float64, (None,))
        self._set_array("motor_z", np.float64, (len(self.motor_names), None))
        require_known("parameters", self.motor_names, PARAMETERS)

    @classmethod
    def nominal(cls, springs: SpringParameters, printed: BuiltParameters | None = None) -> RobotParameters:
        """The robot as designed, but with these springs: wire, coil and turns give the stiffness and the mass
        of its motors. `printed`: the robot with the kit's springs; by default with pins."""
        kit, own = SpringParameters(), printed or BuiltParameters()

        def scaled(stiffness: float, martensite: float) -> float:
            # Rounded: sizes that a rig file gives in millimetres are off by a last digit.
            return round(springs.stiffness(martensite) / kit.stiffness(martensite), 12) * stiffness

        with_springs = replace(
            own,
            cold_stiffness=scaled(own.cold_stiffness, 1.0),
            hot_stiffness=scaled(own.hot_stiffness, 0.0),
            active_spring=own.active_spring + round(springs.mass - kit.mass, 12),
        )
        return cls(with_springs, springs)

    @property
    def uniform(self) -> RobotParameters:
        """The same robot with all strips as in the drawing, equal friction of all feet, and equal springs in
        all motors."""
        return RobotParameters(self.printed, self.springs)

    @property
    def has_individual_parts(self) -> bool:
        """Whether lengths of single strips, or differences between springs, are known."""
        return bool(len(self.strips) or len(self.motor_names) or self.own_springs)

    @property
    def free_lengths(self) -> tuple[float, float]:
        """Cold and hot free length of the springs [m], as `eldir.built.motion.drive` takes them: apart by a
        millimetre at least, also at values of uncertain parameters that no spring has."""
        cold, hot = self.springs.cold_length, self.springs.hot_length
        return cold, max(hot, cold + _MIN_STROKE)

    def has_stroke(self, motors: int) -> bool:
        """Whether the springs of all motors are longer hot than cold."""
        return all(
            one.hot_length > one.cold_length + _MIN_STROKE
            for one in (self.springs, *self.motor_springs(motors))
        )

    def motor_springs(self, motors: int) -> list[SpringParameters]:
        """Parameters of the spring of each of `motors` motors. Raises `InputError` where `own_springs` has
        another number of them."""
        if self.own_springs:
            require_count("springs", len(self.own_springs), motors, "motor")
            return list(self.own_springs)
        own = [self.springs] * motors
        for name, z in zip(self.motor_names, self.motor_z, strict=True):
            own = [PARAMETERS[name].at(one, float(value)) for one, value in zip(own, z, strict=True)]
        return own

    def at(self, names: Sequence[str], z: Sequence[float] | FloatArray) -> RobotParameters:
        """The robot whose P uncertain parameters are changed by `z` standard deviations of their priors,
        shape (P,). Differences of single parts stay."""
        require_known("parameters", names, PARAMETERS)
        printed, springs, own = self.printed, self.springs, self.own_springs
        for name, value in zip(names, z, strict=True):
            printed = PARAMETERS[name].at(printed, float(value))
            springs = PARAMETERS[name].at(springs, float(value))
            own = tuple(PARAMETERS[name].at(spring, float(value)) for spring in own)
        return replace(self, printed=printed, springs=springs, own_springs=own)

    def with_parts(
        self, strips: FloatArray, springs: Mapping[str, FloatArray | Sequence[float]]
    ) -> RobotParameters:
        """The robot with these differences of strips (as `strips`) and with these values of each motor's
        spring, by quantity, in the unit of `QUANTITIES`, shape (A,) each."""
        z = []
        for name, values in springs.items():
            mean, parameter = QUANTITIES[name].value(self), PARAMETERS[name]
            with np.errstate(over="ignore"):
                ratios = np.divide(values, mean)
            good = parameter.additive or ((ratios > 0) & np.isfinite(ratios)).all()
            require_value(f"{name} of a motor", good, "more than 0", values)
            off = np.subtract(values, mean) if parameter.additive else np.log(ratios)
            z.append(off / parameter.spread / parameter.powers[QUANTITIES[name].field])
        table = np.array(z) if z else np.zeros((0, 0))
        return replace(self, strips=strips, motor_names=tuple(springs), motor_z=table)


@dataclass(frozen=True)
class Quantity:
    """A physical quantity that results list."""

    field: str
    """Name of a field of `BuiltParameters` or `SpringParameters`."""
    additive: bool = False
    """Whether its interval is symmetric about the value, not about the logarithm of the value."""

    @property
    def unit(self) -> str:
        """Its unit, as the text of the field has it; 1 without one."""
        texts = field_texts(BuiltParameters) | field_texts(SpringParameters)
        found = re.search(r"\[(.+?)\]", texts[self.field])
        return found[1] if found else "1"

    def value(self, robot: RobotParameters) -> float:
        """Value for the whole robot, in `unit`."""
        part = robot.printed if hasattr(robot.printed, self.field) else robot.springs
        return float(getattr(part, self.field))

    def interval(self, value: float, half_width: float) -> tuple[float, float]:
        """Ends of an interval about a value, in `unit`; `half_width` of its logarithm (in `unit`, if
        additive)."""
        if self.additive:
            return value - half_width, value + half_width
        return float(value * np.exp(-half_width)), float(value * np.exp(half_width))

    def gradient(self, names: Sequence[str]) -> FloatArray:
        """Derivative of its logarithm (of the value itself, if additive) with respect to z of each named
        parameter, shape (P,)."""
        return np.array([PARAMETERS[n].spread * PARAMETERS[n].powers.get(self.field, 0.0) for n in names])


QUANTITIES = {p.quantity: Quantity(p.field, p.additive) for p in LISTED}
"""Quantities that results list, by name."""


def sample_feet(masses: int, rng: np.random.Generator) -> FloatArray:
    """Friction of the feet of one robot as multiples of its mean friction, each sampled separately, shape
    (M,)."""
    return np.exp(FOOT_SPREAD * rng.standard_normal(masses))


def sample_springs(
    motors: int, springs: SpringParameters, tolerances: RigTolerances, rng: np.random.Generator
) -> tuple[SpringParameters, ...]:
    """The spring of each motor: the mean of two springs within their tolerances, one on each face."""
    own = [[tolerances.perturb_one(springs, rng) for _ in FACES] for _ in range(motors)]
    return tuple(SpringParameters.mean(both) for both in own)


def part_names(morphology: Morphology) -> tuple[str, ...]:
    """Names of the parameters of a robot's single parts: "strip 7", "spring 1 hot_length"."""
    strips = [f"{_STRIP} {s}" for s in np.flatnonzero(~morphology.active)]
    springs = [f"{_SPRING} {a} {name}" for name in SPRING_SPREADS for a in range(1, morphology.motors)]
    return (*strips, *springs)


def perturb_robot(
    morphology: Morphology,
    nominal: RobotParameters,
    names: Sequence[str],
    z: Sequence[float] | FloatArray,
) -> RobotParameters:
    """The nominal robot with the named parameters changed by `z` standard deviations of their priors. The
    names may be those of single parts (`part_names`)."""
    pairs = list(zip(names, z, strict=True))
    common = [(name, value) for name, value in pairs if name in PARAMETERS]
    whole = nominal.at([name for name, _ in common], [value for _, value in common])
    if len(common) == len(pairs):
        return whole
    strips = np.zeros(len(morphology.active))
    differences = {name: np.zeros(morphology.motors) for name in SPRING_SPREADS}
    for name, value in pairs:
        kind, *which = name.split(" ")
        if kind == _STRIP:
            strips[int(which[0])] = STRIP_SPREAD * value
        elif kind == _SPRING:
            spread = SPRING_SPREADS[which[1]] / PARAMETERS[which[1]].spread
            differences[which[1]] += spread * value * contrasts(morphology.motors)[int(which[0]) - 1]
    motor_z = np.array(list(differences.values()))
    return replace(whole, strips=strips, motor_names=tuple(differences), motor_z=motor_z)


@cache
def contrasts(motors: int) -> FloatArray:
    """Helmert contrasts between motors: orthogonal rows with sum zero and mean square one, shape (motors - 1,
    motors)."""
    rows = np.zeros((motors - 1, motors))
    for i in range(1, motors):
        rows[i - 1, :i], rows[i - 1, i] = 1.0, -i
    return rows / np.sqrt((rows**2).mean(axis=1, keepdims=True))
