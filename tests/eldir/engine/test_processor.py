"""What the kernels know of the processor, against what NumPy asks of it, and for other processors."""

from __future__ import annotations

import platform
from pathlib import Path

import pytest
from numpy._core._multiarray_umath import __cpu_features__

from eldir.engine.kernels import simd


def test_numpy_finds_the_same_registers_here() -> None:
    assert simd.has_wide_registers() == __cpu_features__.get("AVX512F", False)


@pytest.mark.parametrize(
    ("machine", "flags", "wide"),
    [
        ("x86_64", "flags\t\t: fpu avx avx2 avx512f avx512dq\nbugs\t\t:\n", True),
        ("x86_64", "flags\t\t: fpu avx avx2 avx512f\n", True),
        ("x86_64", "flags\t\t: fpu avx avx2\n", False),
        ("x86_64", None, False),
        ("aarch64", "Features\t: fp asimd evtstrm\n", False),
        ("aarch64", "flags\t\t: fpu avx avx2 avx512f\n", False),  # emulated: the host's flags
    ],
)
def test_registers_of_other_processors(
    machine: str, flags: str | None, wide: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if flags is not None:
        (tmp_path / "cpuinfo").write_text(flags)
    monkeypatch.setattr(simd, "CPU_FLAGS", tmp_path / "cpuinfo")
    monkeypatch.setattr(platform, "machine", lambda: machine)
    assert simd.has_wide_registers.__wrapped__() is wide
