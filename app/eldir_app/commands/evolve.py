"""The command `eldir evolve`: its options. `evolution_run.py` runs the evolution in the terminal."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eldir.core.kernels import PRECISION, AskedDevice, Precision
from eldir.evolution import defaults
from eldir.evolution.defaults import Crossover, Ground, Objective
from eldir.evolution.printed import defaults as built
from eldir.training.defaults import ITERATIONS, OPTIMISER, UPDATE_LENGTHS, Optimiser
from eldir_app.terminal.device import DEVICE_OPTION, choose_device

if TYPE_CHECKING:
    from eldir.training.configuration import Training
    from eldir.training.randomisation import Randomisation

_FOR_BUILT = {
    "out", "objective", "rig", "lattice", "population", "generations", "max_motors", "static_margin", "seed",
    "cluster", "as_json",
}  # fmt: skip


def evolve(
    context: typer.Context,
    *,
    out: Annotated[Path | None, typer.Option(metavar="RUN", help="New run folder.")] = None,
    resume: Annotated[
        Path | None, typer.Option(metavar="RUN", help="Continue this run; the run keeps its own settings.")
    ] = None,
    objective: Annotated[
        Objective,
        typer.Option(
            "--objective",
            help="What robots are judged by: paper, learning in the paper's scene; printed, the walk of the "
            "printed robot with a heating gait that evolves with it.",
        ),
    ] = defaults.OBJECTIVE,
    rig: Annotated[
        Path | None, typer.Option(help="For printed robots: the rig file whose springs and limits count.")
    ] = None,
    lattice: Annotated[
        str | None,
        typer.Option(
            metavar="ROWSxCOLUMNS",
            help="Size of the lattice. Default: 13x22 as in the paper; printed robots 6x11.",
        ),
    ] = None,
    population: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=defaults.MOST_POPULATION,
            help=f"Robots in a generation. Default: {defaults.POPULATION}; printed robots {built.OFFSPRING}.",
        ),
    ] = None,
    generations: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=defaults.MOST_GENERATIONS,
            help="Generations of offspring after the random one. Default: "
            f"{defaults.GENERATIONS}; printed robots {built.GENERATIONS}.",
        ),
    ] = None,
    terrain: Annotated[Ground, typer.Option(help="Ground: flat, or rugged and level, rising or falling.")] = (
        defaults.GROUND
    ),
    precision: Annotated[
        Precision,
        typer.Option(
            help="Numbers of the learning: with f64, results of two machines part later, and it takes longer."
        ),
    ] = PRECISION,
    max_motors: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Largest number of motors (active springs). Default: any; printed: as the rig heats.",
        ),
    ] = None,
    static_margin: Annotated[
        float | None,
        typer.Option(metavar="MM", help="Reject bodies with a smaller static margin when built, such as 20."),
    ] = None,
    buildable: Annotated[
        bool,
        typer.Option(
            "--buildable",
            help="Reject bodies that can fold, or that their motors cannot deform, when built.",
        ),
    ] = False,
    second_stage: Annotated[
        bool,
        typer.Option("--second-stage", help="Simulate survivors as built; remove those that fall over."),
    ] = False,
    inherit: Annotated[
        bool, typer.Option("--inherit", help="Offspring start from the learned weights of their parent.")
    ] = False,
    optimiser: Annotated[
        Optimiser, typer.Option(help="Update rule: steps of one length as in the paper, or Adam.")
    ] = OPTIMISER,
    update_length: Annotated[
        float | None,
        typer.Option(
            help=f"Length of an update; with Adam, of the first one. Default: {UPDATE_LENGTHS['steps']:g}, "
            f"with Adam {UPDATE_LENGTHS['adam']:g}."
        ),
    ] = None,
    window: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="STEPS",
            help="Truncate gradients to windows of this many steps. Default: the whole rollout.",
        ),
    ] = None,
    iterations: Annotated[
        int, typer.Option(min=1, max=defaults.MOST_ITERATIONS, help="Learning updates of every robot.")
    ] = ITERATIONS,
    randomise: Annotated[
        str | None,
        typer.Option(
            metavar="SCENE",
            help="Randomise the physics: by a file of eldir calibrate dynamics, or unfilmed for the priors.",
        ),
    ] = None,
    crossover: Annotated[
        Crossover, typer.Option(help="How two progenitors are combined into one offspring.")
    ] = (defaults.CROSSOVER),
    seed: Annotated[
        int, typer.Option(min=0, help="Random seed of the run; the same seed gives the same bytes.")
    ] = defaults.SEED,
    cluster: Annotated[
        bool,
        typer.Option("--cluster", help="Learn and simulate on the Ray cluster of RAY_ADDRESS or ray start."),
    ] = False,
    device: Annotated[AskedDevice | None, DEVICE_OPTION] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the status of the run as JSON.")] = False,
    explain: Annotated[
        bool,
        typer.Option("--explain", help="Print which computations the engine skips in this run, and why."),
    ] = False,
) -> None:
    """Evolve bodies that learn to walk, and teach each one by gradient descent.

    With --objective printed, bodies and heating gaits evolve together. Each robot is judged by the walk of
    samples of the printed robot: the mean less half the standard deviation, a fall counted as no walk.

    Ctrl-C stops the run when the robots that are learning are done. --resume continues a run that was stopped
    or killed; the result has the same bytes as an uninterrupted run. eldir status RUN prints its status.

    Example: eldir evolve --objective printed --out run --seed 1
    """
    choose_device(device)
    if (out is None) == (resume is None):
        raise typer.BadParameter("give either --out RUN for a new run or --resume RUN to continue one")
    if resume is not None:
        if wrong := _given_beside(context, {"resume", "cluster", "device", "as_json", "explain"}):
            raise typer.BadParameter(f"--resume keeps the run's own settings; remove {wrong}")
        _continue(resume, context, cluster, as_json, explain)
        return
    assert out is not None
    size = None if lattice is None else _parse_lattice(lattice)
    if objective == "printed":
        if wrong := _given_beside(context, _FOR_BUILT):
            raise typer.BadParameter(f"--objective printed judges walks of printed robots; remove {wrong}")
        from eldir_app.terminal.evolution_run import new_printed_run, run_evolution

        margin = None if static_margin is None else 1e-3 * static_margin
        run_evolution(
            new_printed_run(out, rig, size, population, generations, max_motors, margin, seed),
            cluster,
            as_json,
            new=True,
        )
        return
    if rig is not None:
        raise typer.BadParameter("--rig counts only with --objective printed")
    from eldir.evolution.run_folder import RunFolder
    from eldir.evolution.search import EvolutionConfig, scene_on
    from eldir.lattice import Lattice
    from eldir_app.terminal.evolution_run import run_evolution

    config = EvolutionConfig(
        lattice=Lattice(*(size or defaults.LATTICE)),
        population=defaults.POPULATION if population is None else population,
        generations=defaults.GENERATIONS if generations is None else generations,
        max_active=max_motors,
        static_margin=None if static_margin is None else 1e-3 * static_margin,
        buildable=buildable,
        second_stage=second_stage,
        crossover=crossover,
        inherit=inherit,
        iterations=iterations,
        randomisation=None if randomise is None else _randomisation(randomise),
        seed=seed,
        scene=scene_on(terrain, seed).replace(window=window, precision=precision),
        training=_training(optimiser, update_length),
    )
    run_evolution(RunFolder.create(out, config), cluster, as_json, explain, new=True)


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


def _continue(resume: Path, context: typer.Context, cluster: bool, as_json: bool, explain: bool) -> None:
    from eldir.evolution.designs import open_run
    from eldir.evolution.printed.run_folder import PrintedRun
    from eldir_app.terminal.evolution_run import run_evolution

    run = open_run(resume)
    if isinstance(run, PrintedRun) and (wrong := _given_beside(context, {"resume", "cluster", "as_json"})):
        raise typer.BadParameter(f"a run for building has no {wrong}")
    run_evolution(run, cluster, as_json, explain)


def _given_beside(context: typer.Context, allowed: set[str]) -> str:
    """The options on the command line beside these, in words; empty if there are none."""
    given = [
        f"--{name.replace('_', '-')}"
        for name in context.params
        if name not in allowed
        and (source := context.get_parameter_source(name)) is not None
        and source.name == "COMMANDLINE"
    ]
    return ", ".join(given)
