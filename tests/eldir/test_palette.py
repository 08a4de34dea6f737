"""One palette for every picture of a robot, and colours that colour-blind readers tell apart."""

from itertools import combinations

import numpy as np
import pytest

from eldir.core import pictures as palette
from tests.paths import PACKAGES, ROOT

# Linear RGB as a dichromat sees it: Vienot, Brettel and Mollon, Color Research and Application 24 (1999) 243.
SEEN = {
    "all cones": np.eye(3),
    "no red cones": np.array([[0.11238, 0.88762, 0.0], [0.11238, 0.88762, 0.0], [0.00401, -0.00401, 1.0]]),
    "no green cones": np.array([[0.29275, 0.70725, 0.0], [0.29275, 0.70725, 0.0], [-0.02234, 0.02234, 1.0]]),
}
PARTS = {"motor": palette.MOTOR, "passive": palette.PASSIVE, "mark": palette.MARK, "ground": palette.GROUND}


def lab(colour: str, seen: np.ndarray) -> np.ndarray:
    """CIE L*a*b* of a colour, D65."""
    rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.clip(seen @ np.where(rgb > 0.04045, ((rgb + 0.055) / 1.055) ** 2.4, rgb / 12.92), 0, 1)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    x, y, z = np.cbrt(to_xyz @ linear / [0.9505, 1.0, 1.089])
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


@pytest.mark.parametrize("cones", SEEN)
def test_parts_are_told_apart(cones):
    """By 20 at least, where 2.3 is just noticeable. The packet's former motors (#c1440e) and marks (#2e8b57)
    were 22 apart without red cones."""
    seen = {name: lab(colour, SEEN[cones]) for name, colour in PARTS.items()}
    for one, other in combinations(seen, 2):
        assert np.linalg.norm(seen[one] - seen[other]) > 20, (one, other)
    assert np.linalg.norm(seen["motor"] - seen["mark"]) > 60


def test_a_motor_grows_darker_as_it_contracts():
    light = [lab(c, SEEN["all cones"])[0] for c in (palette.MOTOR_SHORT, palette.MOTOR, palette.MOTOR_LONG)]
    assert light[1] - light[0] > 20 and light[2] - light[1] > 20


def test_no_other_module_gives_motors_a_colour_of_their_own():
    for path in [ROOT / "eldir" / "show.py", *PACKAGES["eldir_cad"].rglob("*.py")]:
        assert not any(old in path.read_text() for old in ("#1f9d3a", "#c1440e", "#2e8b57")), path
