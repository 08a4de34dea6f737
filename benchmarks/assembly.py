"""`python -m benchmarks.assembly MODULE:FUNCTION [COMPILER] [ARCHITECTURE ...]`: the kernels that a function
launches, assembled for NVIDIA's GPUs on a machine without one.

The compilers find a driver of ours (`stub_driver.c`) that takes their code (PTX) and runs nothing. NVIDIA's
assembler (`pip install nvidia-cuda-nvcc-cu12`) then reports registers, spills and shared memory. A real
driver has the same assembler.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from eldir.core.arguments import require_value
from eldir.errors import EldirError, MissingDependencyError

SOURCE = Path(__file__).with_name("stub_driver.c")
_CHILD = """
import json, sys
from importlib import import_module
from eldir.engine.compiler import ti
place, wanted, arguments = sys.argv[1:]
module, name = place.split(":")
function = getattr(import_module(module), name)

def check():
    started = ti.lang.impl.current_cfg().arch.name
    if started != wanted:
        sys.exit(f"{started} started instead of {wanted}")

ti.init(arch=getattr(ti, wanted), log_level=ti.ERROR)
check()
result = function(*json.loads(arguments))
check()
print(json.dumps(result))
"""
CAPABILITY = 80
"""Compute capability of the stub, times ten. For newer devices the compilers write the same code with another
head (Taichi up to 8.6, Quadrants up to 9.0)."""


class Architecture(NamedTuple):
    """Limits of one multiprocessor: CUDA C++ Programming Guide, "Technical specifications per compute
    capability"."""

    threads: int
    blocks: int
    shared: int
    """Shared memory [bytes]."""
    registers: int = 65536


ARCHITECTURES = {
    80: Architecture(threads=2048, blocks=32, shared=164 << 10),
    90: Architecture(threads=2048, blocks=32, shared=228 << 10),
    120: Architecture(threads=1536, blocks=24, shared=100 << 10),
}
"""By compute capability, times ten: A100, H100 and H200, GeForce RTX 50."""


class Launch(NamedTuple):
    """A kernel that was launched, with the file of its PTX."""

    file: Path
    kernel: str
    blocks: int
    threads: int
    """Threads of a block."""
    shared: int
    """Dynamic shared memory of a block [bytes]."""


class AssembledKernel(NamedTuple):
    """What the assembler made of a kernel. Sizes are in bytes, of a thread or (shared memory) of a block."""

    kernel: str
    architecture: int
    threads: int
    registers: int
    stack: int
    spill_stores: int
    spill_loads: int
    shared: int
    barriers: int
    blocks: int
    """Blocks that fit on a multiprocessor at the same time."""
    file: Path
    """The machine code (cubin)."""


def find_tool(name: str) -> str:
    """`ptxas` or `nvdisasm`: of NVIDIA's packages, or on the path.

    Raises: MissingDependencyError."""
    spec = find_spec("nvidia")
    folders = spec.submodule_search_locations or [] if spec else []
    made = [str(tool) for folder in folders for tool in sorted(Path(folder).glob(f"*/bin/{name}"))]
    found = (made and made[0]) or shutil.which(name) or shutil.which(name, path="/usr/local/cuda/bin")
    if not found:
        package = {"ptxas": "nvidia-cuda-nvcc-cu12"}.get(name, f"nvidia-cuda-{name}")
        raise MissingDependencyError(f"{name} is not installed", remedy=f"pip install {package}")
    return found


def compile_stub(folder: Path) -> None:
    """The driver without a device, as `folder`/libcuda.so."""
    compiler = shutil.which("cc")
    if compiler is None:
        raise MissingDependencyError("the stub driver needs a C compiler named cc")
    command: list[str | Path] = [compiler, "-O1", "-shared", "-fPIC", "-o", folder / "libcuda.so", SOURCE]
    subprocess.run(command, check=True, capture_output=True)


def call(
    function: str,
    *arguments: object,
    arch: str,
    compiler: str,
    environment: dict[str, str],
    max_s: float = 300.0,
) -> Any:
    """Call `function` ("module:name") in a process of its own, with `compiler` started on `arch` ("cuda" or
    "vulkan") and with more variables of the environment. Arguments and result pass as JSON. No cache.

    Raises: EldirError, also where no device was found: the compilers then start on the processor."""
    variables = os.environ | {
        "ELDIR_COMPILER": compiler,
        "PYTHONPATH": os.pathsep.join(filter(None, [os.getcwd(), *sys.path])),
        "TI_OFFLINE_CACHE": "0",
        "QD_OFFLINE_CACHE": "0",
    }
    command = [sys.executable, "-c", _CHILD, function, arch, json.dumps(arguments)]
    ran = subprocess.run(
        command, env=variables | environment, capture_output=True, text=True, check=False, timeout=max_s
    )
    if ran.returncode:
        last = ran.stderr.strip().splitlines()[-1:] or [f"status {ran.returncode}"]
        raise EldirError(f"{function} ended with an error on {compiler}", found=last[0])
    return json.loads(ran.stdout.splitlines()[-1])


def launch_on_stub(function: str, *arguments: object, compiler: str, folder: Path) -> list[Launch]:
    """Call `function` ("module:name") with CUDA on the stub driver, in a process of its own.

    Returns each launched kernel once, in their order, without those of the compiler's own runtime. Files are
    kept in `folder`. Raises: EldirError."""
    compile_stub(folder)
    log = folder / "launches"
    log.write_text("")
    environment = {
        "LD_LIBRARY_PATH": str(folder),
        "STUB_CAPABILITY": str(CAPABILITY),
        "STUB_FOLDER": str(folder),
    }
    call(function, *arguments, arch="cuda", compiler=compiler, environment=environment)
    launches: dict[str, Launch] = {}
    for line in log.read_text().splitlines():
        module, kernel, *sizes = line.split()
        if not kernel.startswith("runtime_"):
            launches.setdefault(kernel, Launch(folder / f"{module}.ptx", kernel, *map(int, sizes)))
    if not launches:
        raise EldirError(f"{function} launched no kernel")
    return list(launches.values())


def assemble(
    launches: Sequence[Launch], architecture: int, max_registers: int | None = None
) -> list[AssembledKernel]:
    """Assemble all launched kernels for one of ARCHITECTURES. `max_registers` of a thread replaces what the
    compilers ask for: two blocks or more on a multiprocessor. Raises: EldirError."""
    assembled: list[AssembledKernel] = []
    for file in dict.fromkeys(launch.file for launch in launches):
        source = file.read_text()
        if max_registers is not None:
            source = re.sub(r"^\.minnctapersm \d+", f".maxnreg {max_registers}", source, flags=re.MULTILINE)
        code = file.with_suffix(f".sm_{architecture}.cubin")
        command = [find_tool("ptxas"), "-v", f"-arch=sm_{architecture}", "-o", str(code), "-"]
        ran = subprocess.run(command, input=source, capture_output=True, text=True, check=False)
        if ran.returncode:
            raise EldirError(f"ptxas refused {file.name} for sm_{architecture}", found=ran.stderr.strip())
        told = _read_report(ran.stderr)
        of_file = [launch for launch in launches if launch.file == file]
        assembled += [_kernel(launch, architecture, told[launch.kernel], code) for launch in of_file]
    return assembled


_KINDS = {
    "registers": r"Used (\d+) registers",
    "stack": r"(\d+) bytes stack frame",
    "spill_stores": r"(\d+) bytes spill stores",
    "spill_loads": r"(\d+) bytes spill loads",
    "shared": r"(\d+) bytes smem",
    "barriers": r"used (\d+) barriers",
}


def _read_report(text: str) -> dict[str, dict[str, int]]:
    """What `ptxas -v` says of each kernel."""
    _, *parts = re.split(r"Compiling entry function '(\w+)'", text)
    told = {}
    for name, part in zip(parts[::2], parts[1::2], strict=True):
        found = {kind: re.search(pattern, part) for kind, pattern in _KINDS.items()}
        told[name] = {kind: int(match[1]) if match else 0 for kind, match in found.items()}
    return told


def _kernel(launch: Launch, architecture: int, told: dict[str, int], code: Path) -> AssembledKernel:
    blocks = blocks_per_multiprocessor(
        architecture, launch.threads, told["registers"], told["shared"] + launch.shared
    )
    told = told | {"shared": told["shared"] + launch.shared}
    return AssembledKernel(launch.kernel, architecture, launch.threads, **told, blocks=blocks, file=code)


def blocks_per_multiprocessor(architecture: int, threads: int, registers: int, shared: int) -> int:
    """Blocks that run at the same time on a multiprocessor, as NVIDIA's occupancy calculator counts them.

    A warp takes registers in steps of 256, and each quarter of a multiprocessor has a quarter of them.
    A block takes shared memory in steps of 128 bytes, and 1 KiB more.
    """
    has = ARCHITECTURES[architecture]
    warps = _steps(threads, 32)
    fitting_warps = has.registers // 4 // (_steps(max(registers, 1) * 32, 256) * 256) * 4
    return min(
        has.blocks,
        has.threads // 32 // warps,
        fitting_warps // warps,
        has.shared // (_steps(shared, 128) * 128 + 1024),
    )


def _steps(size: int, step: int) -> int:
    return -(-size // step)


def table(kernels: Sequence[AssembledKernel]) -> Iterator[str]:
    """Lines for a person."""
    width = max(len(kernel.kernel) for kernel in kernels)
    yield f"{'kernel':{width}}    sm threads registers stack spills shared [B] blocks warps"
    for k in kernels:
        warps = k.blocks * _steps(k.threads, 32)
        yield (
            f"{k.kernel:{width}} {k.architecture:5} {k.threads:7} {k.registers:9} {k.stack:5} "
            f"{k.spill_stores + k.spill_loads:6} {k.shared:10} {k.blocks:6} {warps:5}"
        )


def main() -> int:
    """Status 0 if all kernels were assembled."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.assembly", description="See benchmarks/README.md."
    )
    parser.add_argument(
        "function", metavar="MODULE:FUNCTION", help="launches the kernels; takes no arguments"
    )
    parser.add_argument("compiler", nargs="?", default="taichi", choices=("taichi", "quadrants"))
    parser.add_argument("architectures", nargs="*", type=int, default=[*ARCHITECTURES], help="such as 90")
    parser.add_argument("--registers", type=int, metavar="N", help="at most so many of a thread")
    parser.add_argument("--loops", action="store_true", help="also the loops with their instructions")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep PTX and machine code in this folder")
    given = parser.parse_args()
    from benchmarks.machine_code import describe_loops

    try:
        for name in given.architectures:
            require_value("architecture", name in ARCHITECTURES, f"one of {[*ARCHITECTURES]}", str(name))
        with tempfile.TemporaryDirectory() as scratch:
            folder = given.keep or Path(scratch)
            folder.mkdir(exist_ok=True)
            launches = launch_on_stub(given.function, compiler=given.compiler, folder=folder)
            kernels = [k for sm in given.architectures for k in assemble(launches, sm, given.registers)]
            print(*table(kernels), sep="\n")
            for kernel in kernels if given.loops else ():
                print("", *describe_loops(kernel), sep="\n")
    except EldirError as error:
        print(f"benchmarks.assembly: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
