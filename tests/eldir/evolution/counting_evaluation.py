"""An evaluation that counts its robots."""

from tests.eldir.evolution.killed_run import Pretence


class Counting(Pretence):
    """Remembers the seeds of the robots that it taught, and may be told to fail."""

    def __init__(self, shards: int = 10**9):
        self.seeds: list[int] = []
        self.left = shards

    def __call__(self, shards):
        for shard, outcome in super().__call__(shards):
            self.seeds += shard.seeds
            self.left -= 1
            yield shard, outcome

    def stopped(self) -> bool:
        return self.left <= 0
