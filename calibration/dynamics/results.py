"""What an identification found: each quantity with its interval, and what stayed unknown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calibration.dynamics.identify import FARTHEST, Fit, Tell, identify, with_parts
from calibration.dynamics.measurements import UNREAD, Bench
from calibration.dynamics.model_check import Goodness, goodness
from calibration.dynamics.recording import Body, Recording, predict
from calibration.dynamics.requirements import require_explained, require_telling
from eldir.built.scene import BuiltScene
from eldir.core.records import FloatArray
from eldir.parameters.robot import SPRING_SPREADS, RobotParameters, robot_at
from eldir.parameters.uncertain import PARAMETERS, QUANTITIES

_KNOWN = 0.5  # of the prior's standard deviation: what is left with more was not identified
_NORMAL = 1.96
_DOUBTFUL = 2.0
"""Intervals are so much wider of a model that is only nearly right: on trial they were too narrow by as much
(docs/decisions/0025-misfit.md)."""
_FORESEEN = 0.9  # of a cycle that robots nearly the same have to share for the next one to count
_EDGE = 0.99  # of the range of a knob
_UNSEEN = 1.5  # times the limit may be left where a prediction has gone on for a cycle


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
    nominal: RobotParameters,
    *,
    others: Sequence[RobotParameters] = (),
    bench: Bench = UNREAD,
    names: Sequence[str] = tuple(PARAMETERS),
    seed: int = 0,
    tell: Tell = lambda what, part: None,
    provenance: dict[str, Any] | None = None,
) -> BuiltScene:
    """Fit all cycles but the last one of the last recording, and hold that against the prediction.

    `others` are nominal robots of another make, tried where the first leaves more than noise. Where they do
    as well, every strip and spring gets turns of its own, first of the supposed make; that ends the search
    where it fits or is nearly right, and leaves less than all makes of like parts. Of those that fit or are
    nearly right, or of all, whichever predicts the last cycle best is taken. What was read on the `bench` no
    film tells.
    """
    require_telling(recordings)
    *earlier, last = recordings
    shown = [*earlier, last.until(last.end - last.period)]
    fit = identify(body, shown, nominal, names, bench=bench, seed=seed, tell=tell)
    require_explained(recordings, fit.left[0])
    tried = [Candidate.of(body, last, nominal, fit)]
    if not fit.goodness.fits:
        for other in others:
            fit = identify(body, shown, other, names, bench=bench, seed=seed, tell=tell)
            tried.append(Candidate.of(body, last, other, fit, supposed=False))
        if not any(c.fit.goodness.fits for c in tried):
            least = min(c.fit.goodness.unexplained for c in tried)
            for c in [c for c in tried if c.fit.goodness.decided]:
                fit = with_parts(body, shown, c.nominal, c.fit, bench=bench, tell=tell)
                tried.append(Candidate.of(body, last, c.nominal, fit, c.supposed))
                if tried[-1].fits and fit.goodness.unexplained < least:
                    break
    best = min(tried, key=lambda c: (not c.fits, c.held_out.left))
    knobs = tuple(names)
    found = best.individual(body)
    strips, springs = _parts(found)
    return BuiltScene(
        found.uniform.with_parts(strips, springs) if best.parts else found,
        knobs,
        best.likely(knobs),
        np.array([_rounded(float(v)) for v in best.fit.z[: len(knobs)]]),
        best.fits,
        results=results(best, tried, body, last),
        provenance=provenance or {},
    )


@dataclass(frozen=True)
class Candidate:
    """A fit of one make of the robot, and how well it predicts a cycle that it never saw."""

    nominal: RobotParameters
    fit: Fit
    held_out: Goodness
    supposed: bool = True
    """Whether it is the make that was supposed; another one was chosen by the film itself."""
    foreseen: bool = True
    """Whether robots nearly the same do alike in the cycle before."""

    @classmethod
    def of(
        cls, body: Body, recording: Recording, nominal: RobotParameters, fit: Fit, supposed: bool = True
    ) -> Candidate:
        """Judged by a recording's last cycle."""
        found = robot_at(body.morphology, nominal, fit.names, fit.z)
        (x,) = predict(body, [recording], [found])[0]
        t = recording.tracked.times
        unseen = np.where(
            (t > recording.end - recording.period)[:, None, None], recording.tracked.positions, np.nan
        )
        later = replace(recording, tracked=replace(recording.tracked, positions=unseen))
        kept = fit.goodness.kept[-1]
        before = t[: len(kept)] > recording.end - 2 * recording.period
        return cls(nominal, fit, goodness([later], [x]), supposed, kept[before].mean() > _FORESEEN)

    @property
    def fits(self) -> bool:
        """Whether it is a model of this robot, and its knobs mean what they say."""
        return self.predicts and not self.strained

    @property
    def predicts(self) -> bool:
        """Whether nothing but noise and chance is left of what it was shown, and of what not unless landings
        decide that; of a model of every part, whether little enough is."""
        shown = self.fit.goodness
        allowed = shown.tolerable if self.parts else shown.limit
        return (
            shown.decided
            and shown.unexplained <= allowed
            and (not self.foreseen or self.held_out.unexplained <= _UNSEEN * allowed)
        )

    @property
    def strained(self) -> list[str]:
        """Knobs as far from what is likely as a fit may turn them: they stand in for something else."""
        far = np.abs(self.fit.z) > _EDGE * FARTHEST
        return [name for name, edge in zip(self.fit.names, far, strict=True) if edge]

    @property
    def parts(self) -> bool:
        """Whether every strip and spring has turns of its own."""
        return any(name not in PARAMETERS for name in self.fit.names)

    def individual(self, body: Body) -> RobotParameters:
        """The robot that it found."""
        return robot_at(body.morphology, self.nominal, self.fit.names, self.fit.z)

    def covariance(self, knobs: Sequence[str]) -> FloatArray:
        """Of some knobs. A model that does not fit turned them for the wrong reasons, and of one that was not
        supposed only the film says that it is right: they are no surer than before, and doubtful by as much
        as they were turned."""
        if self.fits and self.supposed:
            return self.likely(knobs)
        return np.diag(1 + self.fit.z[: len(knobs)] ** 2)

    def likely(self, knobs: Sequence[str]) -> FloatArray:
        """The same of robots that move like this one. Where it predicts, they are near it, whatever its knobs
        stand for."""
        n = len(knobs)
        if not self.predicts:
            return self.covariance(knobs)
        found = self.fit.covariance[:n, :n]
        surely = self.supposed and self.fit.goodness.fits and not self.strained
        # Never less sure than the prior.
        wider = np.clip(1 / np.sqrt(np.diag(found)), 1.0, 1.0 if surely else _DOUBTFUL)
        return found * np.outer(wider, wider)

    def to_json(self) -> dict[str, Any]:
        """How it was judged, in plain values."""
        clamped = self.nominal.printed.bending > 0
        return (
            {
                "strips": "clamped" if clamped else "pinned",
                "parts": self.parts,
                "supposed": self.supposed,
                "strained": self.strained,
                "held_out_left_m": _rounded(self.held_out.left),
                "held_out_unexplained_m": _rounded(self.held_out.unexplained),
            }
            | self.fit.goodness.to_json()
            | {"predicts": self.predicts, "fits": self.fits}
        )


def hold_out(body: Body, recording: Recording, nominal: RobotParameters, found: RobotParameters) -> HeldOut:
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


def results(best: Candidate, tried: Sequence[Candidate], body: Body, last: Recording) -> dict[str, Any]:
    """Plain JSON values (docs/schemas/built-scene.schema.json)."""
    fit, nominal = best.fit, best.nominal
    knobs = [n for n in fit.names if n in PARAMETERS]
    whole, covariance = best.individual(body), best.covariance(knobs)
    held = hold_out(body, last, nominal, whole)
    quantities = {}
    for name, quantity in QUANTITIES.items():
        by = quantity.slopes(knobs)
        prior, sd = float(np.sqrt(by @ by)), float(np.sqrt(by @ covariance @ by))
        if prior == 0:
            continue
        value, away = quantity.value(whole), _NORMAL * sd
        interval = [value - away, value + away] if quantity.additive else list(value * np.exp([-away, away]))
        quantities[name] = {
            "value": _rounded(value),
            "unit": quantity.unit,
            "interval": [_rounded(v) for v in interval],
            "nominal": _rounded(quantity.value(nominal)),
            "of_prior": _rounded(sd / prior),
            "identified": best.supposed and sd / prior < _KNOWN,
        }
    parts = {"motor_springs": _parts(whole)[1]} if best.parts else {}
    return {
        "model": best.to_json() | {"tried": [c.to_json() for c in tried]},
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
        "evaluations": sum(c.fit.evaluations for c in tried),
    } | parts


def _parts(whole: RobotParameters) -> tuple[FloatArray, dict[str, list[float]]]:
    """How much longer strips are than drawn [m], in the design's order, and the quantities of each motor's
    spring."""
    own = whole.springs_of(whole.motor_z.shape[1])
    springs = {n: [_rounded(getattr(s, QUANTITIES[n].field)) for s in own] for n in SPRING_SPREADS}
    return np.array([_rounded(v) for v in whole.strips.tolist()]), springs


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")
