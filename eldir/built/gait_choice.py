"""Choice between a filmed gait that walked and another gait (decision 26)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eldir.built.gait import FilmedGait, Gait, describe_loss
from eldir.built.samples import IdentifiedRobots, SampledWalks, simulate_most_probable
from eldir.built.scene import PrintedScene
from eldir.design import Design

_MARGIN, _MARGIN_WITHOUT_FIT = 1.0, 2.0
"""Required margin of a new gait over the filmed one, in standard deviations of its prediction: if the scene's
model fits the films, and if it does not."""


@dataclass(frozen=True)
class GaitChoice:
    """The gait to drive next."""

    gait: Gait
    kept_film: FilmedGait | None
    """The film of the gait, if a filmed gait is kept; otherwise None."""
    reason: str
    """Reason for the choice, in one line."""


def choose_gait(
    design: Design, other: Gait, walks: SampledWalks, filmed: Sequence[FilmedGait], scene: PrintedScene
) -> GaitChoice:
    """Choose the best of the `filmed` gaits or another gait, with which sampled robots walk `walks`.

    The samples must differ from those of the search that found the gait. The standard deviation of the
    prediction has two parts: the spread of the samples, where a fall counts as no motion; and the error of
    the most probable robot in the filmed gaits.
    """
    walking = [film for film in filmed if film.has_walked]
    if not walking:
        why = "no filmed gait walked" if filmed else "there is no film of this robot"
        return GaitChoice(other, None, f"new gait: {why}")
    best = max(walking, key=lambda film: (film.upright, film.walked))  # a robot that was lost comes last
    lost = "" if best.lost_at_s is None else f" ({describe_loss(best.lost_at_s)})"
    robots = IdentifiedRobots.of(design, scene)
    itself, *again = simulate_most_probable(robots, [other, *(film.gait for film in filmed)]).tolist()
    saw = [0.0 if film.has_fallen else film.walked for film in filmed]
    wrong = np.abs(np.where(np.isfinite(again), again, 0.0) - saw).max()
    deviations = _MARGIN if scene.model_fits else _MARGIN_WITHOUT_FIT
    margin = deviations * float(np.hypot(walks.spread_with_falls, wrong))
    predicted = min(walks.expected, itself)
    says = f"{predicted:+.2f} (required margin {margin:.2f})" if np.isfinite(predicted) else "a fall"
    if predicted - margin > best.walked:
        reason = f"new gait: predicted {says}; the best filmed gait walked {best.walked:+.2f}{lost}"
        return GaitChoice(other, None, reason)
    return GaitChoice(
        best.gait,
        best,
        f"filmed gait kept: it walked {best.walked:+.2f}{lost}; predicted for the best other: {says}",
    )
