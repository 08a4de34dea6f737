"""Fields say how far they may be from nominal; seeds give the same robots as in former versions."""

from __future__ import annotations

from typing import Annotated

import numpy as np
import pytest

from eldir.core.records import Record, record
from eldir.parameters.annotations import Prior, Tolerance, VariesWith, vary
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.uncertain import read_parameters


@record
class Lever(Record):
    """A record with parameters of its own."""

    length: Annotated[float, Prior(0.1, "a ruler"), Tolerance(0.5, "relative"), VariesWith("size")] = 2.0
    width: Annotated[float, Prior(0.2, "a caliper", name="size"), Tolerance(0.1, shared="section")] = 3.0
    height: Annotated[float, VariesWith("size", -2.0), Tolerance(0.2, shared="section")] = 4.0
    ground: Annotated[float, Tolerance(1.0, "absolute"), Tolerance(5.0, "absolute", joints="hubs")] = 0.0
    joints: str = "pins"


def test_a_field_says_all_of_its_parameter() -> None:
    length, size = read_parameters(Lever)
    assert (length.name, length.field, length.quantity, length.powers) == ("length",) * 3 + ({"length": 1.0},)
    assert (size.name, size.field, size.quantity) == ("size", "width", "size")
    assert size.powers == {"width": 1.0, "length": 1.0, "height": -2.0}


def test_fields_vary_by_their_tolerances() -> None:
    z, values = (
        np.random.default_rng(0).standard_normal(3),
        vary(Lever(), np.random.default_rng(0), ("width",)),
    )
    assert values["width"] == 3.0 * np.exp(0.1 * z[0]) and values["length"] == 2.0 * (1 + 0.5 * z[1])
    assert values["height"] == 4.0 * np.exp(0.1 * z[0]) and values["ground"] == z[2]
    grounds = [vary(Lever(joints="hubs"), np.random.default_rng(i))["ground"] for i in range(300)]
    assert max(grounds) == 10.0 and min(grounds) == -10.0, "at most two standard deviations"


def test_a_parameter_has_its_prior_at_one_field() -> None:
    @record
    class Astray(Record):
        length: Annotated[float, VariesWith("sizes")] = 1.0

    @record
    class Twice(Record):
        width: Annotated[float, Prior(0.1, "a ruler", name="length")] = 1.0

    for other, named in ((Astray, "sizes"), (Twice, "length")):
        with pytest.raises(TypeError, match=named):
            read_parameters(Lever, other)


def test_seeds_give_the_robots_of_former_versions() -> None:
    """The order of the random numbers, written out."""
    nominal = BuiltParameters().with_hubs()
    spreads = {
        "tension": 0.1, "buckling": 0.1, "strip_damping": 0.2, "active_damping": 0.2, "drag": 0.1,
        "hexagon": 0.05, "half_connector": 0.05, "strip": 0.05, "active_spring": 0.02, "cold_stiffness": 0.05,
    }  # fmt: skip
    of_hubs = {"bending": 0.1, "socket_friction": 0.5, "strip_damping": 0.5}
    for seed in range(20):
        rng = np.random.default_rng(seed)
        factors = {name: np.exp(spread * rng.standard_normal()) for name, spread in spreads.items()}
        factors |= {"hot_stiffness": factors["cold_stiffness"], "friction": rng.uniform(0.7, 1.3)}
        factors |= {name: np.exp(spread * rng.standard_normal()) for name, spread in of_hubs.items()}
        values = {name: getattr(nominal, name) * float(factor) for name, factor in factors.items()}
        robot = nominal.perturb(np.random.default_rng(seed))
        assert {name: getattr(robot, name) for name in values} == values and robot.geometry == 0.3e-3


def test_seeds_give_the_springs_of_former_versions() -> None:
    nominal = SpringParameters()
    relative = {"heat_capacity": 0.03, "convection_fan": 0.04, "convection_still": 0.04, "latent_heat": 0.05}
    for seed in range(20):
        z = np.clip(np.random.default_rng(seed).standard_normal(8), -2, 2).tolist()
        spring = nominal.perturb(np.random.default_rng(seed))
        for (name, spread), own in zip(relative.items(), z, strict=False):
            assert getattr(spring, name) == getattr(nominal, name) * (1 + spread * own)
        for name in ("austenite_start", "austenite_finish", "martensite_start", "martensite_finish"):
            assert getattr(spring, name) == getattr(nominal, name) + z[4]
        assert (spring.cold_length, spring.hot_length) == (0.035 + 1e-3 * z[5], 0.075 + 1e-3 * z[6])
        assert spring.resistance == pytest.approx(nominal.resistance * (1 + 0.02 * z[7]), rel=1e-14)
