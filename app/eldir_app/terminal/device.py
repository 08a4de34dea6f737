"""The option --device of commands in which robots learn."""

from __future__ import annotations

import os
from typing import Any

import typer

from eldir.core.kernels import AskedDevice

DEVICE_OPTION: Any = typer.Option(
    "--device",
    help="Where robots learn: on the processor, on a GPU by CUDA or Vulkan, or auto: by CUDA where there is "
    "a GPU. Default: ELDIR_DEVICE, or cpu.",
)


def choose_device(device: AskedDevice | None) -> None:
    """Let robots learn there from now on, in this process; None: where `ELDIR_DEVICE` says."""
    if device is not None:
        os.environ["ELDIR_DEVICE"] = device
