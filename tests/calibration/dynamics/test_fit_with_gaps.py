"""Which frames a fit uses in which order, where landings decide the motion in some; the fits themselves are
given here, because each takes minutes."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from eldir_calibration.dynamics import _fits
from eldir_calibration.dynamics._fits import DynamicsFit
from eldir_calibration.dynamics._model_check import ModelCheck
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG, IdentificationConfig

FRAMES = 10


@dataclass(frozen=True)
class Film:
    """Stands for a problem: it knows only which frames it has."""

    recordings: tuple[Any, ...] = (None,)
    noise: tuple[float, float] = (1.0, 1.0)
    step_widths: Any = None
    config: IdentificationConfig = DEFAULT_CONFIG

    def divergence(self, z: np.ndarray, linear: SimpleNamespace) -> None:
        return None


def check(kept: str, unexplained: float) -> ModelCheck:
    frames = (np.array([c == "x" for c in kept]),)
    smooth = np.full((2, 1), unexplained)
    return ModelCheck(("m1",), smooth, 1e-4, unexplained, 1e-4, 1e-2, frames, (0.0,))


def fitted(checks: list[ModelCheck], monkeypatch: pytest.MonkeyPatch) -> tuple[DynamicsFit, list[str]]:
    """The fit that is taken where the robots of successive fits have these checks; and the frames of each."""
    used: list[str] = []

    def fit(
        problem: Film, z: np.ndarray, rounds: object, evaluations: int, progress: object
    ) -> tuple[DynamicsFit, SimpleNamespace]:
        kept = problem.recordings[0]
        used.append("x" * FRAMES if kept is None else "".join("x" if k else "." for k in kept))
        number = len(used) - 1
        nothing = np.zeros(0)
        place = np.array([float(number)])
        found = DynamicsFit(
            (), place, nothing, (0.0, 0.0), (1.0, 1.0), evaluations + 1, nothing, checks[number]
        )
        return found, SimpleNamespace(z=place, positions=place)

    monkeypatch.setattr(_fits, "_fit_rounds", fit)
    monkeypatch.setattr(_fits, "mask_frames", lambda recordings, kept: tuple(kept))
    monkeypatch.setattr(_fits, "_check_fit", lambda problem, linear, chance: checks[int(linear.z[0])])
    monkeypatch.setattr(_fits, "check_model", lambda film, place, config: checks[int(place[0])])
    found = _fits.fit_reproducible(Film(), np.zeros(0), (1,), 0, lambda what, part: None)  # type: ignore[arg-type]
    return found, used


def test_the_whole_film_is_fitted_again_where_its_first_frames_have_made_it_clear(monkeypatch) -> None:
    """The robot of the first frames diverges nowhere, and is far off later: a film of a robot with hubs."""
    checks = [check("xxxx..xxxx", 3e-4), check("xxxxxxxxxx", 2.6e-3), check("xxxxxxxxxx", 1e-4)]
    found, used = fitted([*checks, checks[-1]], monkeypatch)
    assert used[:3] == ["x" * FRAMES, "xxxx......", "x" * FRAMES]
    assert found.check is checks[2]


def test_a_later_fit_that_is_worse_is_not_taken(monkeypatch) -> None:
    checks = [check("xxxx..xxxx", 3e-4), check("xxxx..xxxx", 9e-4), check("xxxx..xxxx", 8e-4)]
    found, used = fitted(checks, monkeypatch)
    assert used == ["x" * FRAMES, "xxxx......", "xxxx..xxxx"]
    assert found.check is checks[0] and found.evaluations == 3


def test_a_robot_in_a_wrong_place_is_not_taken_because_no_landing_decides_its_motion(monkeypatch) -> None:
    """So it was with rig 270 of the ten robots in MuJoCo: 0.2 mm against 3.1 mm."""
    checks = [check("xxxxxx..xx", 2e-4), check("xxxxxxxxxx", 3.1e-3), check("xxxxxxxxxx", 3.0e-3)]
    found, _ = fitted([*checks, checks[-1]], monkeypatch)
    assert found.check is checks[0]


def test_a_fit_that_shows_more_of_the_film_is_taken(monkeypatch) -> None:
    checks = [check("xx........", 1.5e-4), check("xxxxxx....", 2e-4), check("xxxxxxxx..", 2e-4)]
    found, used = fitted([*checks, checks[-1]], monkeypatch)
    assert used == ["x" * FRAMES, "xx........", "xxxxxx....", "xxxxxxxx.."]
    assert found.check.reproducible_share == 0.8


@pytest.mark.parametrize("kept", ["xxxxxxxxxx", "xxxxxxxxxxxxxxxxxxx."])
def test_one_fit_is_enough_where_hardly_anything_is_left_out_or_unexplained(kept, monkeypatch) -> None:
    found, used = fitted([check(kept, 0.5e-4)], monkeypatch)
    assert len(used) == 1 and found.evaluations == 1
