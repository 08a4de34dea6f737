"""The verdict on transferred predictions, against formulas by hand and properties."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eldir_calibration.transfer.biplane_walks import BiplaneWalk
from eldir_calibration.transfer.verdict import ExplainedWalk, TransferAgreement, TransferVerdict
from tests.calibration.transfer.made_up_walks import FALL, compared

WALKS = st.lists(st.floats(-2, 2).map(lambda v: round(v, 6)), min_size=3, max_size=12, unique=True)


def spread_around(walk: float) -> list[float]:
    return [walk - 0.1, walk, walk + 0.1]


@given(WALKS)
def test_a_perfect_prediction_has_no_fault(walks: list[float]) -> None:
    found = TransferAgreement.of([compared(spread_around(w), [w, w]) for w in walks])
    assert found.spearman == pytest.approx(1.0)
    assert found.mean_error == pytest.approx(0.0, abs=1e-12)
    assert found.coverage == 1.0
    assert found.right_sign == 1.0 or min(abs(w) for w in walks) < 1e-9


@given(WALKS)
def test_a_reversed_prediction_has_the_worst_order(walks: list[float]) -> None:
    found = TransferAgreement.of([compared(spread_around(w), [-w, -w]) for w in walks])
    assert found.spearman == pytest.approx(-1.0)
    assert found.mean_error == pytest.approx(2 * np.mean(np.abs(walks)))
    assert found.right_sign == np.mean([abs(w) < 1e-9 for w in walks])


@given(WALKS, st.randoms())
def test_the_rank_correlation_is_that_of_the_textbook(walks: list[float], random: object) -> None:
    """1 - 6 sum d^2 / (n (n^2 - 1)), for ranks without ties."""
    there = walks.copy()
    random.shuffle(there)  # type: ignore[attr-defined]
    ranks = [np.argsort(np.argsort(v)) for v in (walks, there)]
    n, d = len(walks), ranks[0] - ranks[1]
    pairs = zip(walks, there, strict=True)
    found = TransferAgreement.of([compared(spread_around(a), [b, b]) for a, b in pairs])
    assert found.spearman == pytest.approx(1 - 6 * float(d @ d) / (n * (n * n - 1)))


def test_the_interval_is_that_of_one_more_robot() -> None:
    """Mean 1, standard deviation 0.1 from three: 4.3027 * 0.1 * sqrt(4 / 3) by the table of Student's t."""
    one = compared([0.9, 1.0, 1.1, FALL], [0.51, 1.49, 0.49, FALL])
    assert one.interval == pytest.approx((1 - 0.49683, 1 + 0.49683), abs=1e-4)
    assert one.within_interval.tolist() == [True, True, False, True], "a sample fell too"
    assert not compared([0.9, 1.0, 1.1], [1.0, FALL]).within_interval[1], "a fall that no sample had"


def test_the_interval_covers_what_it_promises() -> None:
    """Robots of one normal distribution: 95 % of further ones, however few samples."""
    rng = np.random.default_rng(1)
    for samples in (2, 4, 8):
        drawn = rng.normal(0.3, 0.2, (4000, samples + 1))
        inside = [compared(row[:-1], row[-1:]).within_interval[0] for row in drawn]
        assert np.mean(inside) == pytest.approx(0.95, abs=0.012)


def test_a_prediction_of_falls_is_right_about_falls_alone() -> None:
    one = compared([FALL, FALL, 0.4], [FALL, 0.4])
    assert one.interval is None and one.within_interval.tolist() == [True, False]
    assert one.means == pytest.approx((0.4 / 3, 0.2)), "falls count as no motion"


def test_walks_flagged_as_ties_are_told_apart() -> None:
    sure = [compared(spread_around(w), [w + 0.05] * 2, ties=0.3) for w in (0.2, 0.5, 0.9)]
    tied = [compared(spread_around(0.3), [-0.3, -0.3], ties=0.31)]
    verdict = TransferVerdict.of([*sure, *tied])
    assert (verdict.all_walks.walks, verdict.untied.walks, verdict.tied.walks) == (4, 3, 1)
    assert verdict.untied.right_sign == 1.0 and verdict.tied.right_sign == 0.0
    assert verdict.all_walks.right_sign == 0.75
    assert verdict.untied.mean_error == pytest.approx(0.05)
    assert verdict.all_walks.mean_error == pytest.approx((3 * 0.05 + 0.6) / 4)
    assert verdict.reached == {
        "spearman": False, "right_sign": True, "coverage": False, "mean_error": True
    }  # fmt: skip
    told = " ".join(verdict.sentences)
    assert "1 of them flagged as ties" in told
    assert "3 of 3 walks go the predicted way (goal: at least 95 %, reached)" in told
    assert "of those flagged as ties 0 of 1" in told
    assert "75% of the robots" in told and "missed" in told


def test_a_goal_is_reached_within_its_ends_only() -> None:
    near = [compared(spread_around(w), [w + 0.01] * 9 + [w + 5.0]) for w in (0.2, 0.5, 0.9)]
    wide = [compared(spread_around(w), [w + 0.01] * 10) for w in (0.2, 0.5, 0.9)]
    assert TransferVerdict.of(near).reached["coverage"] is True
    assert TransferVerdict.of(wide).reached["coverage"] is False
    assert "more means that the intervals are wide" in " ".join(TransferVerdict.of(wide).sentences)


def test_robots_flagged_as_ties_count_for_the_interval() -> None:
    """Without ties 27 of 30 robots walk within it, and none of the ten that ties make doubtful."""
    near = [compared(spread_around(w), [w + 0.01] * 9 + [w + 5.0], ties=0.0) for w in (0.2, 0.5, 0.9)]
    assert TransferVerdict.of(near).reached["coverage"] is True
    verdict = TransferVerdict.of([*near, compared(spread_around(0.3), [-5.0] * 10, ties=0.9)])
    assert verdict.goal_values["coverage"] == pytest.approx(27 / 40)
    assert verdict.reached["coverage"] is False
    assert "68% of the robots" in " ".join(verdict.sentences)


def test_a_number_that_is_its_goal_reaches_it() -> None:
    """One pair out of order among five: 1 - 6 * 2 / 120 = 0.9, but for rounding."""
    walks, there = (0.1, 0.2, 0.3, 0.4, 0.5), (0.2, 0.1, 0.3, 0.4, 0.5)
    verdict = TransferVerdict.of(
        [compared(spread_around(a), [b, b]) for a, b in zip(walks, there, strict=True)]
    )
    assert verdict.all_walks.spearman == pytest.approx(0.9) and verdict.reached["spearman"] is True


def test_too_few_walks_have_no_order_and_the_verdict_says_so() -> None:
    verdict = TransferVerdict.of([compared(spread_around(w), [w, w], ties=0.9) for w in (0.1, 0.2)])
    assert np.isnan(verdict.all_walks.spearman) and verdict.reached["spearman"] is None
    assert verdict.all_walks.to_json()["spearman"] is None
    told = " ".join(verdict.sentences)
    assert (
        "no rank correlation" in told
        and "all walks are flagged as ties" in told
        and "These are few walks" in told
    )
    assert np.isnan(TransferAgreement.of([compared([0.1, 0.1], [0.2, 0.2])] * 4).spearman), "all alike"


def test_an_explanation_names_the_law_that_brings_both_together() -> None:
    without = {"pins": 0.52, "feet": 0.9, "slope": FALL}
    one = ExplainedWalk("a.json", 1, engine=0.5, mujoco=1.0, without=without)
    assert one.changes["pins"] == pytest.approx(-0.48) and np.isnan(one.changes["slope"])
    assert (
        one.finding
        == "MuJoCo differs from the engine by +0.50, without pins by +0.02; it falls without slope"
    )
    other = ExplainedWalk("a.json", 1, 0.5, 1.0, {"pins": 0.9, "feet": 1.1})
    assert "alone does not explain half" in other.finding
    same = ExplainedWalk("a.json", 1, 0.5, 0.54, {"pins": 0.5, "slope": FALL})
    assert same.finding == "MuJoCo and the engine differ by less than 0.05; it falls without slope"
    assert "falls" in ExplainedWalk("a.json", 1, 0.5, FALL, without).finding


def test_designs_are_ranked_by_what_their_robots_reach_in_mujoco() -> None:
    """Not by the predicted walk. Other phases of a gait are no designs; a fall is no walk."""
    far = replace(
        compared(spread_around(2.0), [2.0, 1.0], file="far.json"),
        in_space=(BiplaneWalk(2.0, yaw=-0.2), BiplaneWalk(1.0, yaw=-np.radians(78.0))),
    )
    steady = compared(spread_around(1.5), [1.5, 1.4], file="steady.json")
    falls = compared(spread_around(3.0), [3.0, FALL], file="falls.json")
    phases = replace(compared(spread_around(3.0), [3.0, 3.0], file="far.json"), is_own_gait=False)
    told = " ".join(TransferVerdict.of([far, falls, steady, phases]).sentences)
    order = "steady.json (1.41); then far.json (1.15, turns by up to 78 degrees in five cycles), "
    assert f"Build first, by the mean walk in MuJoCo less half the standard deviation: {order}" in told
    assert "falls.json (0.44)." in told
    lost = compared(spread_around(1.0), [FALL, FALL], file="lost.json")
    assert TransferVerdict.of([far, lost]).sentences[-2].endswith("lost.json (all fall).")
    back = compared(spread_around(1.0), [-0.5, -0.4], file="back.json")
    advice = TransferVerdict.of([back, lost]).sentences[-2]
    assert advice.startswith("Build none of these designs") and "lost.json (all fall)" in advice
    told = " ".join(TransferVerdict.of([far, phases]).sentences)
    assert "Build" not in told, "there is nothing to choose"
