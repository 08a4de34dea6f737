"""What a motion of the built robot, and its tangents, refuse before the engine reads it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eldir.built.motion import drive
from eldir.built.robot import build, rest_state
from eldir.built.sensitivities import DriveInputs, sensitivities
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from tests.eldir.built.braced_robots import bodies, unheated
from tests.raised import raises

VALUE, SHAPE = "input.wrong-value", "input.wrong-shape"


@pytest.mark.parametrize(
    ("words", "code", "key"),
    [
        ({"every": 0}, VALUE, "every"),
        ({"every": -1}, VALUE, "every"),
        ({"every": 1.5}, VALUE, "every"),
        ({"states": []}, "input.wrong-number", "states"),
        ({"states": [np.zeros((3, 2))]}, SHAPE, "state of robot 0"),
        ({"step": 0.0}, VALUE, "step"),
        ({"step": -1e-5}, VALUE, "step"),
        ({"step": np.nan}, VALUE, "step"),
        ({"step": 1e-12}, VALUE, "step"),
        ({"interval": 0.0}, VALUE, "interval"),
        ({"interval": np.nan}, VALUE, "interval"),
        ({"interval": np.inf}, VALUE, "interval"),
    ],
    ids=str,
)
@pytest.mark.parametrize("tangents", [False, True])
def test_wrong_arguments_of_a_motion(words: dict[str, object], code: str, key: str, tangents: bool) -> None:
    """Sizes that the engine believes must be checked before: it would write beyond its arrays."""
    robot = build(bodies(1)[0])
    table, interval = unheated(robot, 3), words.get("interval", 0.01)
    others = {name: value for name, value in words.items() if name != "interval"}
    if tangents and "states" in others:
        (state,) = others.pop("states") or [np.zeros(3)]
        code, key = SHAPE, "state of robot 0"
    else:
        state = None
    with raises(InputError, code, key):
        if tangents:
            sensitivities([DriveInputs(robot, table, interval, state=state)], [["friction"]], **others)
        else:
            drive([robot], [table], interval, **others)


@pytest.mark.parametrize(
    ("free", "code"),
    [
        ((0.03,), SHAPE),
        ([(0.02, 0.03)] * 2, SHAPE),
        ((0.03, 0.03), VALUE),
        ((0.03, 0.02), VALUE),
        ((0.02, np.nan), VALUE),
    ],
)
def test_wrong_free_lengths_of_a_motion(free: object, code: str) -> None:
    robot = build(bodies(1)[0])
    with raises(InputError, code, "free"):
        drive([robot], [unheated(robot, 3)], 0.01, free=free)


def test_a_state_of_another_joint_model() -> None:
    design = bodies(1)[0]
    pinned, hubs, clamped = (
        build(design),
        build(design, BuiltParameters().with_hubs()),
        build(design, BuiltParameters.clamped()),
    )
    for robot, other in ((pinned, hubs), (hubs, pinned), (clamped, pinned), (pinned, clamped)):
        with raises(
            InputError, "input.wrong-shape", "state of robot 0", match=f"its joints are {robot.joints}"
        ):
            drive([robot], [unheated(robot, 3)], 0.01, states=[rest_state(other)])
    with raises(InputError, "input.wrong-shape", "state of robot 0"):
        inputs = DriveInputs(pinned, unheated(pinned, 3), 0.01)
        sensitivities([replace(inputs, state=rest_state(hubs))], [["friction"]])


def test_whole_numbers_of_numpy_are_welcome() -> None:
    robot = build(bodies(1)[0])
    (motion,) = drive([robot], [unheated(robot, 5)], 0.01, every=np.int64(2))
    assert len(motion.positions) == 3
