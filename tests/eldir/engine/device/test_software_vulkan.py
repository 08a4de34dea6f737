"""Software devices run blocks with shared memory and barriers, and write results."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.assembly import call
from eldir.core.kernels import compiler_name
from eldir.errors import EldirError
from tests.eldir.engine.device.software_vulkan import use_driver

ADD_UP = "tests.eldir.engine.device.small_kernels:add_up"


@pytest.mark.parametrize(
    ("driver", "precision", "rounds"),
    [
        ("lavapipe", "f64", 500),
        pytest.param("swiftshader", "f32", 10, marks=pytest.mark.stress),
    ],
)
def test_sums_of_blocks_are_exact(driver: str, precision: str, rounds: int, tmp_path: Path) -> None:
    environment = use_driver(driver, tmp_path)
    sums = call(ADD_UP, precision, rounds, arch="vulkan", compiler=compiler_name(), environment=environment)
    part = 64 * rounds
    assert sums == [part * k * part + part * (part - 1) / 2 for k in range(4)]


def test_a_device_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    """The compilers would go on with the processor."""
    environment = use_driver("lavapipe", tmp_path)
    nothing = {name: str(tmp_path / "nothing.json") for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES")}
    with pytest.raises(EldirError, match=r"x64|arm64"):
        call(ADD_UP, "f64", 1, arch="vulkan", compiler=compiler_name(), environment=environment | nothing)
