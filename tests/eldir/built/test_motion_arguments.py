"""What a motion of the built robot, and its slopes, refuse before the engine reads it."""

from __future__ import annotations

import numpy as np
import pytest

from eldir.built.directions import DriveInputs
from eldir.built.motion import drive
from eldir.built.robot import build, rest_state
from eldir.built.sensitivities import sensitivities
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from tests.eldir.built.braced_robots import bodies, unheated

STATES = "state of robot 0 has the wrong shape"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ({"every": 0}, r"every is wrong; expected a whole number from 1"),
        ({"every": -1}, "every is wrong"),
        ({"every": 1.5}, "every is wrong"),
        ({"states": []}, "every robot needs its state; expected 1; found 0"),
        ({"states": [np.zeros((3, 2))]}, STATES),
        ({"step": 0.0}, "the step is too small"),
        ({"step": -1e-5}, "the step is too small"),
        ({"step": np.nan}, "the step is too small"),
        ({"step": 1e-12}, "the step is too small"),
        ({"interval": 0.0}, "the interval is wrong"),
        ({"interval": np.nan}, "the interval is wrong"),
        ({"interval": np.inf}, "the interval is wrong"),
    ],
    ids=str,
)
@pytest.mark.parametrize("slopes", [False, True])
def test_wrong_arguments_of_a_motion(words: dict[str, object], says: str, slopes: bool) -> None:
    """Sizes that the engine believes must be checked before: it would write beyond its arrays."""
    robot = build(bodies(1)[0])
    table, interval = unheated(robot, 3), words.get("interval", 0.01)
    others = {name: value for name, value in words.items() if name != "interval"}
    with pytest.raises(InputError, match=says):
        if slopes:
            sensitivities([DriveInputs(robot, table, interval)], [["friction"]], **others)
        else:
            drive([robot], [table], interval, **others)


@pytest.mark.parametrize("free", [(0.03,), [(0.02, 0.03)] * 2, (0.03, 0.03), (0.03, 0.02), (0.02, np.nan)])
def test_wrong_free_lengths_of_a_motion(free: object) -> None:
    robot = build(bodies(1)[0])
    with pytest.raises(InputError, match="free lengths"):
        drive([robot], [unheated(robot, 3)], 0.01, free=free)


def test_a_state_of_another_joint_model() -> None:
    design = bodies(1)[0]
    pinned, hubs, clamped = (
        build(design),
        build(design, BuiltParameters().with_hubs()),
        build(design, BuiltParameters.clamped()),
    )
    for robot, other in ((pinned, hubs), (hubs, pinned), (clamped, pinned), (pinned, clamped)):
        with pytest.raises(InputError, match=rf"{STATES}; expected .* as its joints are {robot.joints}"):
            drive([robot], [unheated(robot, 3)], 0.01, states=[rest_state(other)])
    with pytest.raises(InputError, match=STATES):
        inputs = DriveInputs(pinned, unheated(pinned, 3), 0.01)
        sensitivities([inputs], [["friction"]], states=[rest_state(hubs)])


def test_whole_numbers_of_numpy_are_welcome() -> None:
    robot = build(bodies(1)[0])
    (motion,) = drive([robot], [unheated(robot, 5)], 0.01, every=np.int64(2))
    assert len(motion.positions) == 3
