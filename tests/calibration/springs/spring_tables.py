"""Tables of a heated spring from an integration of its heat balance that shares nothing with the product.

    (m c - m L dxi/dT) dT/dt = I^2 R - h (T - T_surroundings)

One heating phase takes the spring from all martensite to all austenite and one cooling phase back, so that
the martensite fraction xi is Liang and Rogers' cosine of the temperature alone. SciPy integrates each phase.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

MASS, AREA = 1.5537e-3, 1.28467e-3  # of the wire of the template's spring [kg], [m2]


@dataclass(frozen=True)
class Truth:
    heat_capacity: float = 480.0
    latent_heat: float = 11_500.0
    convection_still: float = 33.0
    convection_fan: float = 140.0
    austenite_start: float = 46.0
    austenite_finish: float = 61.0
    martensite_start: float = 44.0
    martensite_finish: float = 31.0
    resistance: float = 0.99
    cold_length: float = 0.0345
    hot_length: float = 0.0755
    current: float = 3.45
    ambient: float = 22.0
    warming: float = 0.0  # of the surroundings, from the first sample to the last [K]


def measure(truth: Truth, seed: int = 0, noise: float = 0.3, rate: float = 5.0) -> dict[str, np.ndarray]:
    """Columns of a table; the switches lie anywhere between two samples."""
    rng = np.random.default_rng(seed)
    begin = float(rng.uniform(0.5, 1.0))
    still, fan = 7.0 * (3.45 / truth.current) ** 2, 8.0 * (3.45 / truth.current) ** 2
    ends = np.cumsum([begin, still, 120.0, fan, 60.0]) + rng.uniform(-0.1, 0.1, 5)
    total = float(ends[-1])
    t = np.arange(0.0, total, 1 / rate)
    degrees, fractions = np.full(len(t), np.nan), np.full(len(t), np.nan)
    now, temperature = 0.0, truth.ambient
    for end, current, blown in zip(ends, [0, 1, 0, 1, 0], [0, 0, 0, 1, 1], strict=True):
        inside = (t >= now) & (t < end)
        heating = current > 0
        loss = AREA * (truth.convection_fan if blown else truth.convection_still)
        power = (truth.current * current) ** 2 * truth.resistance
        low, high = (
            (truth.austenite_start, truth.austenite_finish)
            if heating
            else (truth.martensite_finish, truth.martensite_start)
        )

        def slope(t, y, power=power, loss=loss, low=low, high=high):
            around = truth.ambient + truth.warming * t / total
            falling = np.where(
                (y > low) & (y < high),
                np.pi / (high - low) * np.sin(np.pi * (y - low) / (high - low)) / 2,
                0.0,
            )
            return (power - loss * (y - around)) / (
                MASS * (truth.heat_capacity + truth.latent_heat * falling)
            )

        found = solve_ivp(
            slope, (now, end), [temperature], t_eval=[*t[inside], end], max_step=0.1, rtol=1e-8, atol=1e-8
        )
        degrees[inside] = found.y[0, :-1]
        angle = np.clip((degrees[inside] - low) / (high - low), 0, 1)
        fractions[inside] = (1 + np.cos(np.pi * angle)) / 2
        now, temperature = end, found.y[0, -1]
    on = ((t >= ends[0]) & (t < ends[1])) | ((t >= ends[2]) & (t < ends[3]))
    current = truth.current * on
    length = truth.hot_length + (truth.cold_length - truth.hot_length) * fractions
    return {
        "t_s": t,
        "current_a": current,
        "voltage_v": current * truth.resistance * (1 + 0.003 * rng.standard_normal(len(t))),
        "temperature_c": degrees + noise * rng.standard_normal(len(t)),
        "fan": (t >= ends[2]).astype(float),
        "length_mm": 1e3 * length + 0.2 * rng.standard_normal(len(t)),
        "ambient_c": truth.ambient + truth.warming * t / total + 0.05 * rng.standard_normal(len(t)),
    }


def write(path: Path, table: dict[str, np.ndarray], separator: str = ",", encoding: str = "utf-8") -> Path:
    """A CSV file as a logger or, with semicolons, a German spreadsheet writes it."""
    rows = [separator.join(table)]
    for row in zip(*table.values(), strict=True):
        cells = [f"{x:.6g}" if n != "fan" else f"{x:.0f}" for n, x in zip(table, row, strict=True)]
        rows.append(separator.join(c.replace(".", ",") if separator == ";" else c for c in cells))
    path.write_bytes(("\n".join(rows) + "\n").encode(encoding))
    return path
