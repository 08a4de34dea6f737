"""`python -m tests.eldir.engine.device.barriers`: what goes wrong on a device without one of its barriers.

The kernels are compiled with a phase of our own. It counts the phases of a launch, and computes one of them
alone, for some of the threads. So a launch can be played phase by phase, and where a barrier is taken away,
each thread computes the phases on both sides of it before the next thread does. The compilers read
annotations, so they are not postponed here.
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple
from unittest.mock import patch

import numpy as np

from eldir.controller import Controller
from eldir.engine.compiler import ti
from eldir.engine.device import kernels as device
from eldir.engine.device import run as host
from eldir.engine.device.records import ASCENDING, DESCENDING, DeviceLaunch, DeviceTask
from eldir.learning import initial_controllers
from eldir.morphology import Morphology
from eldir.scene import Scene
from tests.eldir.engine.device.device_learning import make_task, on_processor
from tests.eldir.engine.random_robots import SMALL, robots, without_motors

THREADS, STEPS, SPAN = 64, 8, 3
ORDERS = {"ascending": ASCENDING, "descending": DESCENDING}
SCENE = Scene.preset("paper").replace(steps=STEPS, window=5, precision="f64")


class Case(NamedTuple):
    """A robot, and how many updates it makes."""

    scene: Scene = SCENE
    updates: int = 0
    motors: bool = True

    def robots(self) -> tuple[list[Morphology], list[Controller]]:
        if self.motors:
            return robots(SMALL, 1, 5, self.scene)
        return [without_motors()], initial_controllers([without_motors()], self.scene, 1)

    def task(self) -> DeviceTask:
        return make_task(*self.robots(), self.scene, self.updates, SPAN)


CASES = {
    "gradient": Case(),
    "update": Case(updates=1),
    "gradient, deaf": Case(SCENE.replace(sensing="none")),
    "no motors": Case(motors=False),
}
"""All phases occur in them, and all follow each other as they can."""
_COUNTED, _WANTED, _FROM, _TO, _NAMES, _ROOM = 0, 1, 2, 3, 4, 1000
"""Numbers behind the pattern generators' outputs: phases counted so far; the phase that is computed, and for
which threads; then every phase's name."""


class Barrier(NamedTuple):
    kernel: str
    before: str
    after: str


class Loss(NamedTuple):
    """What goes wrong without a barrier, in each order of the threads: the greatest relative error of a loss,
    gradient or weight."""

    barrier: Barrier
    case: str
    errors: dict[str, float]


class Player:
    """Plays launches phase by phase, with or without a barrier."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.seen: dict[Barrier, None] = {}  # in their order
        self.order = ASCENDING
        self.without: Barrier | None = None
        with patch.object(device, "phase_of", self._phase_of):
            self._made = device.kernels.__wrapped__(SCENE.precision, THREADS, False)

    def _number(self, work: object) -> int:
        name = work.__name__  # type: ignore[attr-defined]
        if name not in self.names:
            self.names.append(name)
        return self.names.index(name)

    def _phase_of(self, on_device: bool, threads: int) -> object:
        number, first = self._number, SCENE.steps * 16

        @ti.func
        def phase(work: ti.template(), own, block: ti.template()):
            told = ti.static(block.launch.cpgs)
            count = ti.cast(told[first + _COUNTED], ti.i32)
            told[first + _COUNTED] = count + 1
            told[first + _NAMES + count] = ti.cast(ti.static(number(work)), ti.f64)
            if count == ti.cast(told[first + _WANTED], ti.i32):
                begin, end = ti.cast(told[first + _FROM], ti.i32), ti.cast(told[first + _TO], ti.i32)
                for thread in range(begin, end):
                    work(thread, block)

        return phase

    def _play(self, name: str, launch: DeviceLaunch) -> None:
        kernel, told = getattr(self._made, name), np.append(launch.cpgs, np.zeros(_ROOM))
        launch, numbers = launch._replace(cpgs=told), told[len(launch.cpgs) :]

        def compute(phase: int, begin: int, end: int) -> None:
            numbers[:_NAMES] = 0, phase, begin, end
            kernel(launch)

        compute(-1, 0, 0)
        names = [self.names[int(k)] for k in numbers[_NAMES:][: int(numbers[_COUNTED])]]
        barriers = [Barrier(name, *pair) for pair in pairwise(names)]
        self.seen |= dict.fromkeys(barriers)
        at = 0
        while at < len(names):
            if barriers[at : at + 1] == [self.without]:
                for thread in range(THREADS)[:: self.order]:
                    compute(at, thread, thread + 1)
                    compute(at + 1, thread, thread + 1)
                at += 2
            else:
                compute(at, 0, THREADS)
                at += 1

    def compute(self, task: DeviceTask, order: int = ASCENDING, without: Barrier | None = None) -> np.ndarray:
        """Losses, and gradients or best weights."""
        self.order, self.without = order, without

        def play(name: str) -> device.Kernel:
            return lambda launch: self._play(name, launch)

        played = device.Kernels(*(play(name) for name in device.Kernels._fields))
        with patch.object(host, "kernels", lambda *_: played):
            outcome = host.run(task, host.numpy_memory(self.order))
        return np.concatenate([outcome.losses.ravel(), outcome.best])


NOT_NEEDED = {
    Barrier("forward", "initialize", "sense"),
    Barrier("forward", "advance_masses", "sense"),
    Barrier("forward", "advance_masses", "save_state"),
    Barrier("reverse", "add_sensed_gradients", "advance_masses_adjoint"),
    Barrier("reverse", "add_sensed_gradients", "save_gradients"),
    Barrier("reverse", "hidden_deltas", "advance_masses_adjoint"),
    Barrier("reverse", "hidden_deltas", "save_gradients"),
    Barrier("update", "input_weight_gradients", "motor_weight_gradients"),
}
"""Barriers that make no difference: around them each thread needs its own numbers alone."""


def lose_each() -> Iterator[Loss]:
    """Every barrier, taken away alone."""
    player = Player()
    for name, case in CASES.items():
        known = len(player.seen)
        task = case.task()
        whole = player.compute(task)
        for barrier in [*player.seen][known:]:
            errors = {}
            for direction, order in ORDERS.items():
                found = player.compute(task, order, barrier)
                wrong = np.abs(found - whole) / np.abs(whole).max()
                errors[direction] = float(np.nan_to_num(wrong, nan=np.inf, posinf=np.inf).max())
            yield Loss(barrier, name, errors)


def main() -> None:
    """Print a table."""
    print("| kernel | without the barrier between | and | error ascending | descending | where |")
    print("| --- | --- | --- | --- | --- | --- |")
    with on_processor():
        for (kernel, before, after), case, errors in lose_each():
            told = " | ".join(f"{error:.1e}" if error else "0" for error in errors.values())
            print(f"| {kernel} | {before} | {after} | {told} | {case} |", flush=True)


if __name__ == "__main__":
    main()
