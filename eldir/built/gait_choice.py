"""Whether a gait that the camera saw walking is kept, or another one takes its place (decision 26)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eldir.built.ensembles import Ensemble, as_found
from eldir.built.filmed_gait import SeenGait
from eldir.built.gait import Gait
from eldir.built.scene import BuiltScene
from eldir.design import Design

_FITS, _MISFITS = 1.0, 2.0
"""How often the doubt about a prediction has to be gained, where the scene's model fits and where not."""


@dataclass(frozen=True)
class Choice:
    """The gait to drive next."""

    gait: Gait
    kept: SeenGait | None
    """As which the camera saw it."""
    told: str
    """In one line, and why."""


def choose(
    design: Design, other: Gait, walks: Ensemble, seen: Sequence[SeenGait], scene: BuiltScene
) -> Choice:
    """The best of the gaits that the camera `seen`, or another, of which robots drawn from the scene went
    `walks`.

    These have to be other draws than those by which it was found to be the best. In doubt is how far they
    differ, a fall counted as none, and by how much the most probable robot is wrong about what was seen.
    """
    walking = [s for s in seen if s.walks]
    if not walking:
        why = "no filmed gait walked" if seen else "no film of this robot is known"
        return Choice(other, None, f"re-planned: {why}")
    best = max(walking, key=lambda s: s.walked)
    parts, ballast = scene.parts_of(design), design.ballast / 2
    every = [other, *(s.gait for s in seen)]
    itself, *again = as_found(design.morphology, every, scene, parts, ballast).tolist()
    saw = [s.walked if s.upright else 0.0 for s in seen]
    wrong = np.abs(np.where(np.isfinite(again), again, 0.0) - saw).max()
    doubt = (_FITS if scene.fits else _MISFITS) * float(np.hypot(walks.doubt, wrong))
    promised = min(walks.expected, itself)
    says = f"{promised:+.2f}, in doubt by {doubt:.2f}" if np.isfinite(promised) else "a fall"
    if promised - doubt > best.walked:
        return Choice(other, None, f"re-planned: promises {says}; the best seen walked {best.walked:+.2f}")
    return Choice(best.gait, best, f"kept: seen walking {best.walked:+.2f}; the best other promises {says}")
