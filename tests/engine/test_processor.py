"""What the kernels know of the processor, against what NumPy asks of it, and for other processors."""

from __future__ import annotations

from pathlib import Path

import pytest
from numpy._core._multiarray_umath import __cpu_features__

from eldir.engine.kernels import processor


def test_numpy_finds_the_same_registers_here() -> None:
    assert processor.has_wide_registers() == __cpu_features__.get("AVX512F", False)


@pytest.mark.parametrize(
    ("flags", "wide"),
    [
        ("flags\t\t: fpu avx avx2 avx512f avx512dq\nbugs\t\t:\n", True),
        ("flags\t\t: fpu avx avx2 avx512f\n", True),
        ("flags\t\t: fpu avx avx2\n", False),
        ("Features\t: fp asimd evtstrm\n", False),
        (None, False),
    ],
)
def test_registers_of_other_processors(
    flags: str | None, wide: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if flags is not None:
        (tmp_path / "cpuinfo").write_text(flags)
    monkeypatch.setattr(processor, "_FLAGS", tmp_path / "cpuinfo")
    assert processor.has_wide_registers.__wrapped__() is wide
