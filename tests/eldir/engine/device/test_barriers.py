"""Without any one of a device's barriers, the order of the threads changes what robots learn."""

from __future__ import annotations

import numpy as np
import pytest

from eldir.engine.batch import BatchConfig, run_batch
from tests.eldir.engine.device.barriers import CASES, NOT_NEEDED, ORDERS, Barrier, Player, lose_each
from tests.eldir.engine.device.device_learning import LENGTH, on_processor

pytestmark = pytest.mark.stress


def test_every_barrier_is_needed() -> None:
    with on_processor():
        losses = list(lose_each())
    kernels = {loss.barrier.kernel for loss in losses}
    assert len(losses) >= 24 and kernels == {"forward", "reverse", "update"}
    unseen = {loss.barrier for loss in losses if max(loss.errors.values()) < 1e-6}
    assert unseen <= NOT_NEEDED
    assert all(max(loss.errors.values()) == 0 for loss in losses if loss.barrier in NOT_NEEDED)
    # One order alone does not see them all.
    assert all(
        any(loss.errors[name] == 0 for loss in losses if loss.barrier not in unseen) for name in ORDERS
    )


def test_played_phase_by_phase_robots_learn_as_on_the_cpu() -> None:
    with on_processor():
        player = Player()
        for case in CASES.values():
            wanted = run_batch(
                *case.robots(),
                case.scene,
                config=BatchConfig(backward=True, iterations=case.updates, update_length=LENGTH),
            )
            whole = np.concatenate([wanted.losses.ravel(), wanted.best])
            for order in ORDERS.values():
                found = player.compute(case.task(), order)
                assert np.abs(found - whole).max() <= 1e-9 * np.abs(whole).max()
        assert Barrier("reverse", "spring_impulses_adjoint", "position_gradients") in player.seen
