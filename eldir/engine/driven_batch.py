"""Running built robots as one batch: pack, call the kernel, unpack."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from eldir.engine.driven import PROPERTIES, build
from eldir.engine.pack import offsets, padded_array
from eldir.engine.runtime import aligned, threads


def run(
    springs: Sequence[NDArray[np.int32]],
    motors: Sequence[int],
    properties: NDArray[np.float64],
    substeps: NDArray[np.int32],
    masses: Sequence[NDArray[np.float64]],
    strips: Sequence[NDArray[np.float64]],
    lengths: Sequence[NDArray[np.float64]],
    stiffnesses: Sequence[NDArray[np.float64]],
    states: Sequence[NDArray[np.float64]],
    every: int,
) -> tuple[list[NDArray[np.float64]], list[NDArray[np.float64]], NDArray[np.int32]]:
    """Drive n robots.

    `springs` (S, 2), active ones first; `strips` (4, S): rest length, stiffness, buckling load and
    damping; `lengths` and `stiffnesses` (K + 1, A) of the active springs; `states` (4, M): x, y, vx,
    vy. Returns positions (K // every + 1, M, 2), final states and status (-1, or the interval in which
    a robot blew up).
    """
    n = len(springs)
    m = np.array([len(x) for x in masses], np.int32)
    s = np.array([len(x) for x in springs], np.int32)
    a = np.array(motors, np.int32)
    mp, sp = padded_array(m, 16), padded_array(s, 16)
    mass_at, spring_at = offsets(mp), offsets(sp)
    k = np.array([len(x) - 1 for x in lengths], np.int32)
    samples = k // every + 1
    record_at = offsets(samples * 2 * mp // 16)
    length_at = offsets([x.size for x in lengths])
    state, per_mass = aligned(4 * int(mp.sum()), np.float64), aligned(int(mp.sum()), np.float64)
    ends = [aligned(int(sp.sum()), np.int32) for _ in range(2)]
    values = [aligned(int(sp.sum()), np.float64) for _ in range(4)]
    for r in range(n):
        state[4 * mass_at[r] : 4 * mass_at[r + 1]].reshape(4, -1)[:, : m[r]] = states[r]
        per_mass[mass_at[r] : mass_at[r] + m[r]] = 1.0 / masses[r]
        span = slice(spring_at[r], spring_at[r] + s[r])
        for array, column in zip(ends, springs[r].T, strict=True):
            array[span] = column
        for array, row in zip(values, strips[r], strict=True):
            array[span] = row
        values[0][spring_at[r] + s[r] : spring_at[r + 1]] = 1.0  # padding needs some length
    tables = [aligned(int(length_at[-1]) + 1, np.float64) for _ in range(2)]
    tables[0][:-1] = np.concatenate([x.ravel() for x in lengths])
    tables[1][:-1] = np.concatenate([x.ravel() for x in stiffnesses])
    size = int(4 * sp.max() + 2 * mp.max())
    workers = min(threads(), n)
    workspace = aligned(size * workers, np.float64)
    status, record = aligned(n, np.int32), aligned(16 * int(record_at[-1]), np.float64)
    flat = aligned(n * PROPERTIES, np.float64)
    flat.reshape(n, PROPERTIES)[:, : properties.shape[1]] = properties
    build()(
        n, workers, size, every, aligned(1, np.int32), m, s, a, k, substeps, flat,
        mass_at, spring_at, length_at, record_at, state, state.reshape(-1, 16), per_mass.reshape(-1, 16),
        *ends, *(v.reshape(-1, 16) for v in values), *tables,
        workspace, workspace.reshape(-1, 16), workspace.reshape(-1, 2), status, record.reshape(-1, 16),
    )  # fmt: skip
    positions, final = [], []
    for r in range(n):
        rows = record[16 * record_at[r] : 16 * record_at[r + 1]].reshape(samples[r], 2, mp[r])
        positions.append(rows[:, :, : m[r]].transpose(0, 2, 1).copy())
        final.append(state[4 * mass_at[r] : 4 * mass_at[r + 1]].reshape(4, -1)[:, : m[r]].copy())
    return positions, final, status
