"""What of the cluster can be told without one; a real one is in tests/stress."""

import sys

import pytest

from eldir.errors import InputError, MissingDependencyError
from eldir.evolution.cluster import Cluster, shard_size
from tests.raised import raises


def test_without_ray_the_remedy_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingDependencyError, match=r"eldir\[cluster\]"):
        Cluster()


def test_a_cluster_refuses_devices(monkeypatch):
    """Its workers would learn on processors, and the run file would name the device."""
    monkeypatch.setenv("ELDIR_DEVICE", "vulkan")
    with raises(InputError, "cluster.device"):
        Cluster()


@pytest.mark.parametrize(
    ("robots", "processes", "threads", "size"),
    [
        (10_000, 1, 1, 8),  # one process: shards of SHARD robots for each thread
        (10_000, 4, 16, 128),
        (10_000, 1000, 1, 2),  # at least four shards for each process
        (10, 1000, 1, 1),
        (0, 4, 2, 2),
    ],
)
def test_shards_fit_the_cluster(robots, processes, threads, size):
    assert shard_size(robots, processes, threads) == size
