"""All masses from the marks: what is known exactly must come back, and a hub turns with its springs."""

import numpy as np
import pytest

from eldir_hardware.vision.whole_body import estimate_body, estimate_hub_angles

REST = np.array([(0.0, 0.0), (0.06, 0.0), (0.03, 0.05), (0.09, 0.05), (0.06, 0.1)])
SPRINGS = np.array([(0, 1), (0, 2), (1, 2), (1, 3), (2, 3), (2, 4), (3, 4)])
ACTIVE = np.array([True, False, False, False, False, False, False])
MARKED = np.array([0, 3, 4])


def turned(points, angle, shift):
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]]) + shift


def test_a_body_that_moves_as_a_whole_is_found_exactly():
    true = turned(REST, 0.7, (0.3, 0.1))
    found = estimate_body(REST, SPRINGS, ACTIVE, MARKED, true[MARKED])
    np.testing.assert_allclose(found, true, atol=1e-9)
    np.testing.assert_allclose(estimate_hub_angles(REST, SPRINGS, found), 0.7, atol=1e-9)
    np.testing.assert_allclose(estimate_hub_angles(REST, SPRINGS, turned(REST, -3.0, 0.0)), -3.0, atol=1e-12)


def test_strips_keep_their_lengths_and_coils_do_not():
    """The lower left triangle swings out where the coil between its feet becomes shorter: law of cosines."""
    side, strip = np.linalg.norm(REST[2] - REST[0]), np.linalg.norm(REST[2] - REST[1])
    shorter = 0.045
    bend = np.arccos((side**2 + strip**2 - shorter**2) / (2 * side * strip))
    towards = (REST[1] - REST[2]) / strip
    c, s = np.cos(-bend), np.sin(-bend)
    true = REST.copy()
    true[0] = REST[2] + side * np.array([c * towards[0] - s * towards[1], s * towards[0] + c * towards[1]])
    assert np.linalg.norm(true[0] - true[1]) == pytest.approx(shorter)
    marked = np.array([1, 3, 4])
    all_but_one = estimate_body(REST, SPRINGS, ACTIVE, np.array([0, 3, 4]), true[[0, 3, 4]])
    np.testing.assert_allclose(all_but_one, true, atol=2e-5)
    found = estimate_body(REST, SPRINGS, ACTIVE, marked, true[marked])
    now = np.linalg.norm(found[SPRINGS[:, 1]] - found[SPRINGS[:, 0]], axis=1)
    before = np.linalg.norm(REST[SPRINGS[:, 1]] - REST[SPRINGS[:, 0]], axis=1)
    np.testing.assert_allclose(now[~ACTIVE], before[~ACTIVE], atol=1e-6)
    np.testing.assert_allclose(found[marked], true[marked], atol=1e-6)


def test_masses_without_strips_share_the_marks_differences_by_the_inverse_square_of_the_distance():
    """All springs are coils. Two marks stand 4 mm farther apart than printed, each 2 mm off its place in the
    body that is moved as a whole. A mass half as far from the one as from the other goes four times as much
    with it, and the one in the middle stays."""
    rest = np.array([(0.0, 0.0), (0.3, 0.0), (0.1, 0.0), (0.15, 0.2)])
    marked = np.array([0, 1])
    coils = np.array([(0, 2), (1, 2), (0, 3), (1, 3)])
    found = estimate_body(rest, coils, np.ones(4, bool), marked, rest[marked] + [(-0.002, 0.0), (0.002, 0.0)])
    moved = found - rest
    np.testing.assert_allclose(moved[2], [-0.002 * 0.8 + 0.002 * 0.2, 0.0], atol=1e-9)
    np.testing.assert_allclose(moved[3], 0.0, atol=1e-9)


def test_marks_that_are_not_seen_are_left_out():
    true = turned(REST, -0.2, (0.1, 0.0))
    seen = true[MARKED].copy()
    seen[1] = np.nan
    np.testing.assert_allclose(estimate_body(REST, SPRINGS, ACTIVE, MARKED, seen), true, atol=1e-9)
    seen[0] = np.nan
    assert estimate_body(REST, SPRINGS, ACTIVE, MARKED, seen) is None
