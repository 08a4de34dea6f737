"""The processes that drive devices, one for each: a compiler starts once in a process, for one of them."""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import io
import logging
import os
import queue
from collections.abc import Iterable, Iterator
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from eldir.core.kernels import Device, device_name
from eldir.core.worker_process import WorkerProcess
from eldir.errors import EldirError, InputError, MissingDependencyError

if TYPE_CHECKING:
    from eldir.engine.device.records import DeviceResult, DeviceTask

_logger = logging.getLogger(__name__)
_REMEDY = "use --device cpu or auto, or set ELDIR_DEVICE to one of them"
_RESERVED_MEMORY = 512 << 20
"""Memory of a device that is left to its driver and to others [bytes]."""
_UNKNOWN_MEMORY = 1 << 30
"""Memory that is used of a device that does not report its memory (Vulkan) [bytes]."""
_MAX_VULKAN_STEPS, _MAX_VULKAN_SPAN = 10_000, 200
"""Limits of the steps of a rollout, and of one launch."""


def chosen_device() -> Device:
    """cpu | cuda | vulkan: where robots learn. With `ELDIR_DEVICE=auto` cuda where there is such a device."""
    name = device_name()
    if name != "auto":
        return name
    return "cuda" if cuda_devices() else "cpu"


@cache
def cuda_devices() -> int:
    """Number of CUDA devices that NVIDIA's driver shows; 0 where there is no driver."""
    driver, count = cuda_driver(), ctypes.c_int(0)
    if driver is None or driver.cuInit(0) or driver.cuDeviceGetCount(ctypes.byref(count)):
        return 0
    return count.value


def learns_on_device(record: bool = False, other_gradients: bool = False, shortcuts: bool = True) -> bool:
    """Whether robots learn on a device, or their gradients are computed there.

    Raises `InputError` for what devices do not compute yet. With `ELDIR_DEVICE=auto` it warns instead, and
    the processor computes it."""
    device = chosen_device()
    not_yet = {
        "the states of a robot that learns": record,
        "gradients of physics": other_gradients,
        "rollouts without the engine's shortcuts": not shortcuts,
    }
    missing = [what for what, is_requested in not_yet.items() if is_requested]
    if device == "cpu" or not missing:
        return device != "cpu"
    if device_name() != "auto":
        raise InputError(
            f"{device} does not compute {missing[0]} yet",
            code="device.not-yet",
            remedy=_REMEDY,
        )
    warn_once(f"{device} does not compute {missing[0]} yet: the processor does")
    return False


@cache
def warn_once(message: str) -> None:
    _logger.warning(message)


def compute(task: DeviceTask) -> DeviceResult:
    """Computes a task on the first device that is free. Any thread may call it.

    Raises `EldirError` where there is no device, or where a robot does not fit into its memory."""
    with device_workers(chosen_device()).borrow() as worker:
        worker.begin(run_task, task)
        outcome: DeviceResult = worker.value()
        return outcome


def device_label() -> str:
    """The name of the device on which robots learn, which is started for that. Raises `EldirError`."""
    with device_workers(chosen_device()).borrow() as worker:
        worker.begin(_device_label)
        return str(worker.value())


def device_count() -> int:
    """Devices that compute at the same time."""
    return max(cuda_devices(), 1) if chosen_device() == "cuda" else 1


class DeviceWorkers:
    """A process for each device, started when it is first needed; it lives as long as this process."""

    def __init__(self, device: str):
        self._device = device
        self._started: dict[int, WorkerProcess] = {}
        self._free: queue.Queue[int] = queue.Queue()
        for index in range(device_count()):
            self._free.put(index)
        atexit.register(self.stop, range(device_count()))

    @contextlib.contextmanager
    def borrow(self) -> Iterator[WorkerProcess]:
        index = self._free.get()
        try:
            if index not in self._started:
                self._start(index)
            yield self._started[index]
        except BaseException:  # its answer may still come: stop this process, the next task starts another
            self.stop([index])
            raise
        finally:
            self._free.put(index)

    def _start(self, index: int) -> None:
        shown = os.environ.get("CUDA_VISIBLE_DEVICES", "").split(",")
        name = shown[index] if any(shown) else str(index)
        environment = {"CUDA_VISIBLE_DEVICES": name} if self._device == "cuda" else {}
        self._started[index] = WorkerProcess("eldir.engine.device.run", environment).__enter__()
        self._started[index].begin(start_device, self._device)
        _logger.info("robots learn on %s", self._started[index].value())

    def stop(self, which: Iterable[int]) -> None:
        for index in which:
            if (worker := self._started.pop(index, None)) is not None:
                worker.__exit__(None, None, None)


@cache
def device_workers(device: str) -> DeviceWorkers:
    return DeviceWorkers(device)


def start_device(device: str) -> str:
    """Runs in the worker: starts the compiler on the device, and returns its name.

    The compilers go on with the processor where they find no device, and only warn."""
    from eldir.engine.compiler import NAME, ti

    if device == "cuda" and not cuda_devices():
        raise MissingDependencyError(
            "no CUDA device was found",
            code="device.missing",
            expected="a GPU of NVIDIA and its driver",
            remedy=_REMEDY,
        )
    with contextlib.redirect_stdout(io.StringIO()):  # it prints its version in spite of all settings
        ti.init(arch=getattr(ti, device), log_level=ti.ERROR, offline_cache=True)
    started = _device()
    if started != device:
        raise EldirError(
            f"{NAME} does not start on {device}",
            code="device.missing",
            expected=f"a device with a driver for {device}",
            found=f"it started on {started}",
            remedy=_REMEDY,
        )
    return _device_label()


def _device() -> str:
    """Runs in the worker: where the compiler started."""
    from eldir.engine.compiler import ti

    return str(ti.lang.impl.current_cfg().arch.name)


def run_task(task: DeviceTask) -> DeviceResult:
    """Runs in the worker."""
    from eldir.engine.compiler import ti
    from eldir.engine.device.run import DeviceMemory, batch_bytes, run

    kinds = {"float32": ti.f32, "float64": ti.f64, "int32": ti.i32}

    def empty(count: int, kind: Any) -> Any:
        return ti.ndarray(kinds[np.dtype(kind).name], (max(count, 1),))

    def array(values: NDArray[Any]) -> Any:
        there = empty(len(values), values.dtype)
        if len(values):
            there.from_numpy(values)
        return there

    if _device() == "vulkan":
        task = _shorten_launches(task)
    room = _free_memory() - batch_bytes(task)
    return run(
        task, DeviceMemory(array, empty, lambda there: there.to_numpy(), room // task.weights.itemsize)
    )


def _shorten_launches(task: DeviceTask) -> DeviceTask:
    """Mesa's Vulkan on the processor ends all loops of a launch after 65 535 rounds, without an error."""
    settings = task.settings
    if settings.steps > _MAX_VULKAN_STEPS:
        raise InputError(
            "a rollout is too long for Vulkan",
            code="device.too-many-steps",
            expected=f"at most {_MAX_VULKAN_STEPS:,} steps",
            found=f"{settings.steps:,}",
            remedy="ELDIR_DEVICE=cpu",
        )
    return task._replace(settings=settings._replace(end=min(settings.end, _MAX_VULKAN_SPAN)))


def _free_memory() -> int:
    """Memory of the device that may be used [bytes]."""
    driver, context = cuda_driver(), ctypes.c_void_p()
    free, total = ctypes.c_size_t(0), ctypes.c_size_t(0)
    if _device() == "cuda" and driver is not None and not driver.cuCtxGetCurrent(ctypes.byref(context)):
        if context or not driver.cuDevicePrimaryCtxRetain(ctypes.byref(context), 0):
            driver.cuCtxSetCurrent(context)
            if not driver.cuMemGetInfo_v2(ctypes.byref(free), ctypes.byref(total)):
                return free.value - _RESERVED_MEMORY
    return _UNKNOWN_MEMORY


def _device_label() -> str:
    """Runs in the worker: the device's name."""
    driver, text = cuda_driver(), ctypes.create_string_buffer(256)
    if _device() != "cuda" or driver is None or driver.cuDeviceGetName(text, 256, 0):
        return _device()
    return text.value.decode(errors="replace")


@cache
def cuda_driver() -> Any:
    """NVIDIA's driver; None where there is none."""
    for name in ("libcuda.so.1", "libcuda.so", "nvcuda.dll"):
        with contextlib.suppress(OSError):
            return ctypes.CDLL(name)
    return None
