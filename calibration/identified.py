"""What an identification found: each quantity with its interval, and what stayed unknown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.dynamics import Fit, Tell, identify
from calibration.recording import Body, Recording, predict
from calibration.telling import require_explained, require_telling
from eldir.built_scene import BuiltScene
from eldir.frozen import FloatArray
from eldir.knobs import KNOBS, QUANTITIES, Specimen, specimen

_KNOWN = 0.5  # of the prior's standard deviation: what is left with more was not identified
_NORMAL = 1.96


@dataclass(frozen=True)
class HeldOut:
    """The last cycle, which the fit never saw: vertical ranges of motion [m], shape (marks,)."""

    tracked: FloatArray
    before: FloatArray
    after: FloatArray

    def error(self, ranges: FloatArray) -> float:
        """Mean difference from the camera, as a part of its mean range."""
        return float(np.nanmean(np.abs(ranges - self.tracked)) / np.nanmean(self.tracked))


def calibrate(
    body: Body,
    recordings: Sequence[Recording],
    nominal: Specimen,
    *,
    weight: float | None = None,
    names: Sequence[str] = tuple(KNOBS),
    seed: int = 0,
    tell: Tell = lambda what, part: None,
    provenance: dict[str, Any] | None = None,
) -> BuiltScene:
    """Fit all cycles but the last one of the last recording, and hold that against the prediction.

    `weight` [kg] of one plane of the robot, where it was weighed: no film tells it.
    """
    require_telling(recordings)
    *others, last = recordings
    shown = [*others, last.until(last.end - last.period)]
    fit = identify(body, shown, nominal, names, weight=weight, seed=seed, tell=tell)
    found = specimen(nominal, fit.names, fit.z)
    require_explained(recordings, fit.left[0])
    held = hold_out(body, last, nominal, found)
    return BuiltScene(*found, fit.names, fit.covariance, results(fit, nominal, held), provenance or {})


def hold_out(body: Body, recording: Recording, nominal: Specimen, found: Specimen) -> HeldOut:
    """Vertical ranges in the last cycle of a recording, predicted with both specimens."""
    (before, after), tracked = predict(body, [recording], [nominal, found])[0], recording.tracked.positions
    t = recording.tracked.times
    last = (t >= recording.end - recording.period) & (t <= recording.end)
    seen = np.isfinite(tracked)  # all are asked only where the camera saw the mark
    return HeldOut(*(_ranges(np.where(seen, x, np.nan)[last]) for x in (tracked, before, after)))


def _ranges(x: FloatArray) -> FloatArray:
    heights = x[..., 1]
    found = np.full(heights.shape[1], np.nan)
    some = np.isfinite(heights).any(axis=0)
    found[some] = np.nanmax(heights[:, some], axis=0) - np.nanmin(heights[:, some], axis=0)
    return found


def results(fit: Fit, nominal: Specimen, held: HeldOut) -> dict[str, Any]:
    """Plain JSON values (docs/schemas/built-scene.schema.json)."""
    found = specimen(nominal, fit.names, fit.z)
    quantities = {}
    for name, quantity in QUANTITIES.items():
        by = quantity.by(fit.names)
        prior, sd = float(np.sqrt(by @ by)), float(np.sqrt(by @ fit.covariance @ by))
        if prior == 0:
            continue
        value, away = quantity.value(found), _NORMAL * sd
        interval = [value - away, value + away] if quantity.shifts else list(value * np.exp([-away, away]))
        quantities[name] = {
            "value": _rounded(value),
            "unit": quantity.unit,
            "interval": [_rounded(v) for v in interval],
            "nominal": _rounded(quantity.value(nominal)),
            "of_prior": _rounded(sd / prior),
            "identified": sd / prior < _KNOWN,
        }
    return {
        "turns": {n: _rounded(float(v)) for n, v in zip(fit.names, fit.z, strict=True)},
        "quantities": quantities,
        "not_identified": [n for n, q in quantities.items() if not q["identified"]],
        "left_m": {"shape": _rounded(fit.left[0]), "walk_per_second": _rounded(fit.left[1])},
        "noise_m": {"shape": _rounded(fit.noise[0]), "walk_per_second": _rounded(fit.noise[1])},
        "held_out_cycle": {
            "vertical_range_m": {
                kind: [_rounded(v) if np.isfinite(v) else None for v in getattr(held, kind)]
                for kind in ("tracked", "before", "after")
            },
            "error_before": _rounded(held.error(held.before)),
            "error_after": _rounded(held.error(held.after)),
        },
        "evaluations": fit.evaluations,
    }


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")
