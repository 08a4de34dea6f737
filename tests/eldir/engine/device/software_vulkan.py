"""Vulkan on the processor: Mesa's lavapipe (f32, f64) and Chromium's SwiftShader (f32).

Lavapipe ends every loop when all loops of an invocation together have had 65 000 rounds (65 400 are done)
and gives no warning: what it then writes is wrong. Keep steps few.
"""

from __future__ import annotations

from ctypes.util import find_library
from pathlib import Path

import pytest

_DRIVERS = {
    "lavapipe": ("mesa-vulkan-drivers", "share/vulkan/icd.d/lvp_icd*.json"),
    "swiftshader": ("chromium", "lib*/chromium*/vk_swiftshader_icd.json"),
}


def use_driver(name: str, folder: Path) -> dict[str, str]:
    """Variables of the environment with which Vulkan knows this driver alone: no GPU is used by accident.

    Caches lie in `folder`. The test is skipped where the driver or Vulkan's loader is not installed."""
    package, pattern = _DRIVERS[name]
    found = [
        str(file) for root in ("/usr", "/usr/local", "/opt") for file in sorted(Path(root).glob(pattern))
    ]
    if not found or find_library("vulkan") is None:
        pytest.skip(f"{name} is not installed: apt install {package} libvulkan1")
    return {
        "VK_DRIVER_FILES": found[0],
        "VK_ICD_FILENAMES": found[0],  # its name before 2022
        "VK_ADD_DRIVER_FILES": "",
        "VK_LOADER_LAYERS_DISABLE": "~all~",
        "XDG_RUNTIME_DIR": str(folder),
        "XDG_CACHE_HOME": str(folder),
        "MESA_SHADER_CACHE_DISABLE": "true",
    }
