"""The command `eldir evolve`: what its options make of a run; what a person sees of it: `going_on.py`."""

from __future__ import annotations

import re
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eldir.evolution import defaults
from eldir.evolution.defaults import Crossover
from eldir.training.defaults import ITERATIONS, OPTIMISER, UPDATE_LENGTHS, Optimiser

if TYPE_CHECKING:
    from eldir.scene import Scene
    from eldir.training.configuration import Training
    from eldir.training.randomisation import Randomisation


class Ground(StrEnum):
    """Flat, or rugged with one of three tilts."""

    flat = "flat"
    level = "level"
    incline = "incline"
    decline = "decline"


_TILT = {Ground.level: 0.0, Ground.incline: 0.2, Ground.decline: -0.2}


def evolve(
    context: typer.Context,
    *,
    out: Annotated[Path | None, typer.Option(metavar="RUN", help="New run folder.")] = None,
    resume: Annotated[
        Path | None, typer.Option(metavar="RUN", help="Go on with a run; alone, without other options.")
    ] = None,
    lattice: Annotated[
        str, typer.Option(metavar="ROWSxCOLUMNS", help="13x22 as in the paper, 6x11 for building.")
    ] = f"{defaults.LATTICE[0]}x{defaults.LATTICE[1]}",
    population: Annotated[int, typer.Option(min=1, help="Robots in a generation.")] = defaults.POPULATION,
    generations: Annotated[int, typer.Option(min=0, help="Generations after the random one.")] = (
        defaults.GENERATIONS
    ),
    terrain: Annotated[Ground, typer.Option(help="Flat, or rugged and level, climbing or falling.")] = (
        Ground.flat
    ),
    max_motors: Annotated[
        int | None, typer.Option(min=1, help="Most active springs in a robot; 2 for building. Default: any.")
    ] = None,
    static_margin: Annotated[
        float | None,
        typer.Option(metavar="MM", help="Only bodies that stand this safely when built, such as 20."),
    ] = None,
    buildable: Annotated[
        bool, typer.Option("--buildable", help="Only bodies without loose joints that their motors can move.")
    ] = False,
    second_stage: Annotated[
        bool, typer.Option("--second-stage", help="Drive survivors as built; drop those that fall over.")
    ] = False,
    inherit: Annotated[
        bool, typer.Option("--inherit", help="Offspring start from the taught weights of their parent.")
    ] = False,
    optimiser: Annotated[
        Optimiser, typer.Option(help="Updates of one length as in the paper, or Adam.")
    ] = OPTIMISER,
    update_length: Annotated[
        float | None,
        typer.Option(
            help=f"Length of an update; with Adam, of the first one. Default: {UPDATE_LENGTHS['steps']:g}, "
            f"with Adam {UPDATE_LENGTHS['adam']:g}."
        ),
    ] = None,
    window: Annotated[
        int | None, typer.Option(min=1, metavar="STEPS", help="Trace gradients back over so many steps only.")
    ] = None,
    iterations: Annotated[int, typer.Option(min=1, help="Learning updates of every robot.")] = ITERATIONS,
    randomise: Annotated[
        str | None,
        typer.Option(
            metavar="SCENE",
            help="Learn over physics drawn from what calibrate dynamics found; unfilmed: from priors.",
        ),
    ] = None,
    crossover: Annotated[Crossover, typer.Option(help="How two progenitors are combined.")] = (
        defaults.CROSSOVER
    ),
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same run.")] = defaults.SEED,
    cluster: Annotated[
        bool, typer.Option("--cluster", help="Learn on the Ray cluster that RAY_ADDRESS or ray start names.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print how the run stands as JSON.")] = False,
    explain: Annotated[
        bool, typer.Option("--explain", help="Print what the engine leaves out of this run, and why.")
    ] = False,
) -> None:
    """Evolve bodies that learn to walk, and teach each one by gradient descent.

    Ctrl-C stops at the next robots; a run that was stopped or killed is resumed from there and ends
    with the same bytes. eldir status RUN tells how it stands.

    Example: eldir evolve --out run --lattice 6x11 --max-motors 2 --population 64 --generations 20
    """
    if (out is None) == (resume is None):
        raise typer.BadParameter("give either --out RUN for a new run or --resume RUN for an old one")
    if resume is not None:
        _refuse_others(context)
    rows, columns = _parse_lattice(lattice)
    from eldir.commands.going_on import go_on
    from eldir.evolution.run_folder import Run

    if resume is not None:
        run = Run.open(resume)
    else:
        from eldir.evolution.search import Evolution
        from eldir.lattice import Lattice

        assert out is not None
        config = Evolution(
            lattice=Lattice(rows, columns),
            population=population,
            generations=generations,
            max_active=max_motors,
            static_margin=None if static_margin is None else 1e-3 * static_margin,
            buildable=buildable,
            second_stage=second_stage,
            crossover=crossover,
            inherit=inherit,
            iterations=iterations,
            randomisation=None if randomise is None else _randomisation(randomise),
            seed=seed,
            scene=_scene(terrain, seed).replace(window=window),
            training=_training(optimiser, update_length),
        )
        run = Run.create(out, config)
    go_on(run, cluster, as_json, explain)


def _scene(terrain: Ground, seed: int) -> Scene:
    """The paper's scene; the ground is drawn once and held fixed for the run."""
    import numpy as np

    from eldir.scene import Scene
    from eldir.terrain import Terrain

    scene = Scene.preset("paper")
    if terrain is Ground.flat:
        return scene
    # A key of its own: the robots' seeds have keys of two numbers, the generations' of one.
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, 0, 0)))
    return scene.replace(terrain=Terrain.rugged(rng, _TILT[terrain]))


def _training(optimiser: Optimiser, update_length: float | None) -> Training:
    from eldir.training.configuration import Training

    return Training(optimiser) if update_length is None else Training(optimiser, update_length)


def _randomisation(given: str) -> Randomisation:
    from eldir.built.scene import BuiltScene
    from eldir.training.randomisation import Randomisation

    return Randomisation.unfilmed() if given == "unfilmed" else Randomisation.of(BuiltScene.load(given))


def _parse_lattice(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([1-9]\d{0,2})x([1-9]\d{0,2})", text)
    if match is None:
        raise typer.BadParameter(f"--lattice: expected ROWSxCOLUMNS such as 13x22, found {text!r}")
    return int(match[1]), int(match[2])


def _refuse_others(context: typer.Context) -> None:
    given = [
        f"--{name.replace('_', '-')}"
        for name in context.params
        if name not in ("resume", "cluster", "as_json", "explain")
        and (source := context.get_parameter_source(name)) is not None
        and source.name == "COMMANDLINE"
    ]
    if given:
        raise typer.BadParameter(f"--resume keeps the run's own settings; leave out {', '.join(given)}")
