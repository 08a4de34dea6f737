"""Films of an adaptation, and the belief after them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from eldir.built.gait import FilmedGait
from eldir.built.robot import build
from eldir.built.scene import PrintedScene
from eldir.design import Design
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir_calibration.adaptation.runs import AdaptationConfig
from eldir_calibration.comparison.recorded_run import LoggedRun, open_run
from eldir_calibration.dynamics.belief import Belief, believe
from eldir_calibration.dynamics.recording import (
    NOT_MEASURED,
    Measurements,
    Progress,
    find_any_fall,
    require_informative,
    require_visible,
)
from eldir_calibration.identification.identification import RobotFilms, read_films
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.sections import MEASURED_CURRENT

CURRENT = "current"
"""The parameter of the supply's current."""
MISFIT = "misfit"
"""Entry of a belief's provenance."""


class FilmedWalk(NamedTuple):
    """A gait that was filmed, and the supply and the air of that run."""

    film: FilmedGait
    current_limit_a: float
    """Current limit of the supply [A]."""
    air_c: float | None = None
    """Temperature of the air [C]; None: that of the scene whose robots are compared."""


def filmed_walks(films: Sequence[RobotFilms]) -> list[FilmedWalk]:
    """The gaits in the films, each with its supply and its air."""
    return [
        FilmedWalk(gait, springs.current_limit, springs.ambient)
        for film, springs in ((film, in_room(film.nominal.springs, film)) for film in films)
        for gait in film.filmed_gaits
    ]


def nominal_robot(rig: Rig) -> RobotParameters:
    """The robot as designed, of which the parameters of a belief are deviations: with hubs, on the present
    supply."""
    return RobotParameters.nominal(rig.spring_parameters(), BuiltParameters().with_hubs())


def read_run(
    log: Path, design: Design, rig: Rig, progress: Progress, *, has_moved: bool = False
) -> RobotFilms:
    """The film of a run. Raises `InputError` if it shows too little, if the run was paused, or if robot, rig
    or springs are not those of the folder; the supply's current limit may be another one.

    `has_moved`: whether the robot moved with as much current before. Then it must move: the supply may be
    off. If it has not, its springs may be too cold, which is what the film tells.
    """
    _require_same_run(open_run(log, design), design, rig)
    films = read_films([log], design, progress)
    if not films.filmed_gaits:
        raise InputError(
            f"{log} does not show how far the robot walked",
            code="film.lost",
            expected="a cycle at both ends of which the same marker is seen",
            remedy="light the markers, or remove what hides them",
        )
    # Of a robot that falls sideways after the first cycle, the fall is what the film tells.
    if standing := [one for one in films.recordings if one.fell_at is None]:
        require = require_informative if has_moved else require_visible
        require(standing)
    springs = rig.spring_parameters()
    if replace(films.nominal.springs, current_limit=springs.current_limit) != springs:
        raise InputError(
            f"the springs or the supply of {log} are not those of the rig file",
            code="dynamics.different-rigs",
            expected="the same, but for supply.current_limit_a",
            remedy="begin a new folder",
        )
    if films.current_is_measured != rig.tolerances.current_is_measured:
        raise InputError(
            f"the current of {log} was {'' if films.current_is_measured else 'not '}measured",
            code="dynamics.other-current",
            expected=f"tolerances.current of {MEASURED_CURRENT:g} or less in all runs of a folder or in none",
            remedy="begin a new folder, and give this one as --prior",
        )
    return films


def _require_same_run(run: LoggedRun, design: Design, rig: Rig) -> None:
    """Raise `InputError` for a run of another robot or on another kind of rig, and for one that was paused:
    its cycles are not where the schedule has them."""
    path = run.log.path
    if run.design != design:
        raise InputError(
            f"{path} shows this robot with other ballast or without a motor",
            code="dynamics.different-robots",
            expected="the same robot in all runs of a folder",
            remedy="begin a new folder, and give this one as --prior",
        )
    if run.rig.kind != rig.kind:
        raise InputError(
            f"{path} was made on another rig",
            code="dynamics.different-rigs",
            expected=f"a {rig.kind} rig",
            found=f"a {run.rig.kind} one",
            remedy="begin a new folder",
        )
    run.require_unpaused("give the same command again: the run is repeated")


def known_parameters(rig: Rig) -> tuple[str, ...]:
    """Parameters of the robot that were measured on this rig."""
    return (CURRENT,) if rig.tolerances.current_is_measured else ()


def believe_films(
    design: Design,
    rig: Rig,
    films: Sequence[RobotFilms],
    prior: PrintedScene | None,
    config: AdaptationConfig,
    progress: Progress,
) -> tuple[PrintedScene, Belief]:
    """The belief after all films, as other programs read it, and with its members, for the present supply, in
    the air of the last run. Films of a robot that fell count until it fell, if that is later than the start
    of its first cycle.

    `prior`: what is known before the films, else that of `eldir.parameters`.
    """
    rest, hubs = build(design.morphology).positions[design.marks], BuiltParameters().with_hubs()
    recordings, filmed = [], []
    for film in films:
        (recording,) = film.recordings
        fall = find_any_fall(rest, recording)
        if fall is None or fall > recording.start:
            recordings.append(recording if fall is None else recording.truncate(fall))
            filmed.append(RobotParameters.nominal(in_room(film.nominal.springs, film), hubs))
    nominal = RobotParameters.nominal(in_room(rig.spring_parameters(), films[-1]), hubs)
    read, measured = films[-1].readings, NOT_MEASURED
    if read is not None and recordings and fall is None:
        measured = Measurements(None, read.current_a, read.voltage_v, read.error)
    belief = believe(
        films[-1].body,
        recordings,
        nominal,
        filmed=filmed,
        measurements=measured,
        known=known_parameters(rig),
        prior=prior,
        seed=config.seed,
        progress=progress,
        config=config.belief,
    )
    limit = nominal.springs.current_limit
    scene = replace(
        belief.scene,
        body=design.body,
        ballast_kg=design.ballast if design.ballast.any() else design.ballast[:0],
        filmed_gaits=tuple(
            gait
            for film in films
            for gait in film.filmed_gaits
            if film.nominal.springs.current_limit == limit
        ),
        provenance=films[-1].provenance
        | {key: [one for film in films for one in film.provenance[key]] for key in ("logs", "fingerprints")}
        | {"seed": config.seed, MISFIT: belief.misfit},
    )
    return scene, belief


def in_room(springs: SpringParameters, film: RobotFilms) -> SpringParameters:
    """The springs in the air that was measured before a run."""
    (room,) = film.rooms_c
    return springs.in_air(room)
