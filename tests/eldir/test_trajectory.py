"""Places of points between the times at which they were seen."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from eldir.trajectory import interpolate_near


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 1000), st.floats(0.0, 3.0))
def test_a_point_has_a_place_only_near_to_where_it_was_seen(seed: int, reach: float) -> None:
    """Against every distance in time: on the line between two measurements, and nowhere else."""
    rng = np.random.default_rng(seed)
    times = np.sort(rng.uniform(0, 10, 12))
    values = np.stack([2 * times - 1, np.full(12, np.nan), -times], axis=1)
    values[rng.random((12, 3)) < 0.5] = np.nan
    instants = rng.uniform(-2, 12, 20)
    found = interpolate_near(times, values, instants, reach)
    for k, slope in enumerate((2, 0, -1)):
        seen = times[np.isfinite(values[:, k])]
        near = np.array([np.abs(seen - t).min(initial=np.inf) <= reach for t in instants])
        np.testing.assert_array_equal(np.isfinite(found[:, k]), near)
        if near.any():
            line = slope * np.clip(instants[near], seen.min(), seen.max()) - (1 if slope == 2 else 0)
            np.testing.assert_allclose(found[near, k], line, atol=1e-12)
