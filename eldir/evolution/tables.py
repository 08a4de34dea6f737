"""The Parquet files of a run: columns of genotypes and of lists, and how files are written and read.

Bits are packed eight to a byte, the first bit the highest; masks row by row from the bottom.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldir import errors
from eldir.core.records import BoolArray, FloatArray
from eldir.errors import InputError, not_read
from eldir.lattice import Lattice
from eldir.morphology import offsets

if TYPE_CHECKING:
    import pyarrow as pa


def genotype_bits(triangles: BoolArray, springs: BoolArray) -> dict[str, Any]:
    """Columns with masks (N, B, A) and springs (N, S): the inverse of `genotype_columns`."""
    return {"triangles": _packed(triangles.reshape(len(triangles), -1)), "springs": _packed(springs)}


def genotype_columns(table: pa.Table, lattice: Lattice) -> tuple[BoolArray, BoolArray]:
    """Columns with masks (N, B, A) and springs (N, S)."""
    triangles = _unpacked(table, "triangles", lattice.rows * lattice.columns)
    return (
        triangles.reshape(-1, lattice.rows, lattice.columns),
        _unpacked(table, "springs", len(lattice.springs)),
    )


def rows(table: pa.Table, name: str) -> list[FloatArray]:
    """A column of lists as arrays, without a Python number for every value."""
    found: list[FloatArray] = []
    for chunk in table[name].chunks:
        values: FloatArray = chunk.values.to_numpy()
        ends = chunk.offsets.to_numpy()
        found += [values[a:b] for a, b in pairwise(ends)]
    return found


def lists(arrays: Sequence[FloatArray], kind: type) -> pa.Array:
    """The inverse of `rows`: a column of lists, with values of type `kind`; a matrix becomes one list, row
    by row."""
    import pyarrow as pa

    ends = offsets([a.size for a in arrays])
    values: FloatArray = np.empty(ends[-1], kind)
    for array, (first, end) in zip(arrays, pairwise(ends.tolist()), strict=True):
        values[first:end].reshape(array.shape)[...] = array
    return pa.ListArray.from_arrays(pa.array(ends), pa.array(values))


def to_bytes(columns: dict[str, Any], format_name: str) -> memoryview:
    """A file with checksums. Files with weights are not compressed, because random numbers do not
    compress."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table(columns).replace_schema_metadata({"format": format_name})
    buffer = pa.BufferOutputStream()
    small = "w1" not in columns
    pq.write_table(
        table,
        buffer,
        compression="zstd" if small else "none",
        use_dictionary=False,
        write_statistics=False,
        write_page_checksum=True,
    )
    return memoryview(buffer.getvalue())


def read(path: Path, columns: list[str] | None = None, optional: Sequence[str] = ()) -> pa.Table:
    """Read all or some columns, and of the optional ones those that the file has. Raises `InputError` for a
    missing or damaged file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        if columns is not None and str(path).isprintable():  # Arrow opens no file whose name is not UTF-8
            if optional:
                columns = [*columns, *(k for k in pq.read_schema(path).names if k in optional)]
            return pq.read_table(path, columns=columns, page_checksum_verification=True)
        # Without `read_table`, which starts threads: one that still starts at the program's end aborts it.
        data = pa.BufferReader(path.read_bytes())
        file = pq.ParquetFile(data, page_checksum_verification=True, pre_buffer=False)
        return file.read(columns, use_threads=False)
    except FileNotFoundError as error:
        raise not_read(path, error, "check the run folder") from None
    except (OSError, pa.ArrowException) as error:
        raise damaged(path, "a Parquet file", error) from None


def damaged(path: Path, expected: str, error: Exception) -> InputError:
    """The error for a damaged file, with a remedy."""
    again = "no other file holds its robots; the run itself goes on without it"
    if not path.name.startswith("generation"):
        again = "remove it: its content is computed again from the other files"
    return errors.damaged(path, expected, str(error), again)


def _packed(bits: BoolArray) -> list[bytes]:
    return [row.tobytes() for row in np.packbits(bits, axis=1)]


def _unpacked(table: pa.Table, name: str, count: int) -> BoolArray:
    bits: Sequence[bytes] = table[name].to_pylist()
    packed = np.stack([np.frombuffer(row, np.uint8) for row in bits])
    return np.unpackbits(packed, axis=1, count=count).astype(bool)
