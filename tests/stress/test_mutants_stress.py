"""The tests notice small faults in the code that keeps heat safe: docs/safety-mutants.md."""

import os
from pathlib import Path

import pytest

from tests.stress.mutation.campaign import Campaign

pytestmark = pytest.mark.stress

MOST = 0.05
"""Largest part of the mutants that may survive, explained or not; equivalent ones do not count."""


def test_mutants_of_the_code_that_keeps_heat_safe(tmp_path: Path) -> None:
    """Every core takes its part. `ELDIR_MUTANTS=200` runs a sample of so many."""
    sample = os.environ.get("ELDIR_MUTANTS")
    campaign = Campaign(sample=int(sample) if sample else None)
    results = campaign.run(os.cpu_count() or 1, tmp_path / "mutants.json")
    print(results.table())
    print(*(f"survived: {m}" for m in results.unexplained), sep="\n")
    print(*(f"explained, but a test noticed it: {m}" for m in results.wrongly_explained), sep="\n")
    assert not results.unexplained
    assert results.share <= MOST
