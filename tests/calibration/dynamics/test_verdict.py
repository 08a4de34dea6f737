"""The table of verdicts: every combination of evidence against the rules of decisions 0021 and 0025."""

from __future__ import annotations

from itertools import product

import pytest

from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG
from eldir_calibration.dynamics.verdict import VERDICTS, Evidence, FitVerdict, is_identified

EVERY = [
    Evidence(decided, within, tolerable, supposed, edge)
    for decided, within, tolerable, supposed, edge in product(
        (False, True), (False, True), (False, True), (False, True), ((), ("friction",))
    )
]


@pytest.mark.parametrize("e", EVERY)
def test_a_verdict_follows_from_the_rules(e: Evidence) -> None:
    predicts = e.is_decidable and e.tolerable
    fits = predicts and not e.at_edge
    verdict = e.verdict
    assert verdict.predicts == predicts and verdict.fits == fits
    assert verdict.values_known == (fits and e.assumed), "of what the film chose, nothing is known"
    assert is_identified(verdict, 0.49) == verdict.values_known and not is_identified(verdict, 0.5)
    if predicts:
        exact = fits and e.assumed and e.within_noise
        assert verdict.widening(DEFAULT_CONFIG) == (1.0 if exact else DEFAULT_CONFIG.widening)


def test_every_verdict_has_a_row_and_every_other_row_a_sentence() -> None:
    assert {row.verdict for row in VERDICTS} == set(FitVerdict) == {e.verdict for e in EVERY}
    assert [row.verdict for row in VERDICTS if not row.sentence] == [FitVerdict.FITS]
    both = Evidence(True, False, False, True, ("friction",))
    said = [row.verdict for row in VERDICTS if row.sentence and row.holds(both)]
    assert said == [FitVerdict.AT_EDGE, FitVerdict.WRONG], "a parameter at its edge hides no bad fit"
