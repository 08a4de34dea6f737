"""The command `eldir evolve`: its options, and the run that they describe."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eldir import defaults
from eldir.core.kernels import PRECISION, Precision
from eldir.defaults import (
    ITERATIONS,
    OPTIMISER,
    UPDATE_LENGTHS,
    Crossover,
    EncodingName,
    Objective,
    Optimiser,
)
from eldir_app.options import Device, select_device

if TYPE_CHECKING:
    from eldir.evolution.designs import Run
    from eldir_app.evolution_run import NewRunOptions

_OPTIONS_OF_RESUME = {"resume", "cluster", "device", "as_json", "explain"}
_OPTIONS_OF_OTHER_RESUME = {"resume", "cluster", "as_json"}
_OPTIONS_OF_PROBLEM = {"out", "problem", "population", "generations", "seed", "cluster", "as_json"}
_OPTIONS_OF_PRINTED = {
    "out", "objective", "rig", "lattice", "population", "generations", "terrain", "max_motors",
    "static_margin", "seed", "cluster", "as_json",
}  # fmt: skip

_NewRun = Annotated[Path | None, typer.Option(metavar="RUN", help="New run folder.")]
_Resume = Annotated[
    Path | None, typer.Option(metavar="RUN", help="Continue this run; the run keeps its own settings.")
]
_Objective = Annotated[
    Objective,
    typer.Option(
        "--objective",
        help="What robots are judged by: paper, learning in the paper's scene; printed, the walk of the "
        "printed robot with a heating gait that evolves with it.",
    ),
]
_Problem = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Evolve a problem of your own instead of robots: its name in the entry-point group "
        "eldir.problems of an installed package.",
    ),
]
_Rig = Annotated[
    Path | None, typer.Option(help="For printed robots: the rig file whose springs and limits count.")
]
_Lattice = Annotated[
    str | None,
    typer.Option(
        metavar="ROWSxCOLUMNS",
        help="Size of the lattice. Default: 13x22 as in the paper; printed robots 6x11.",
    ),
]
_Population = Annotated[
    int | None,
    typer.Option(
        min=1,
        max=defaults.MAX_POPULATION,
        help=f"Robots in a generation. Default: {defaults.POPULATION}; "
        f"printed robots {defaults.PRINTED_OFFSPRING}.",
    ),
]
_Generations = Annotated[
    int | None,
    typer.Option(
        min=0,
        max=defaults.MAX_GENERATIONS,
        help="Generations of offspring after the random one. Default: "
        f"{defaults.GENERATIONS}; printed robots {defaults.PRINTED_GENERATIONS}.",
    ),
]
_Terrain = Annotated[
    str,
    typer.Option(
        metavar="[flat|level|incline|decline|FILE]",
        help="Ground: flat; rugged, and level, rising or falling; or a terrain file, .json.",
    ),
]
_Precision = Annotated[
    Precision,
    typer.Option(
        help="Precision of the learning. f64 is slower, and results of two machines agree for longer."
    ),
]
_MaxMotors = Annotated[
    int | None,
    typer.Option(
        min=1, help="Largest number of motors (active springs). Default: any; printed: as the rig heats."
    ),
]
_StaticMargin = Annotated[
    float | None,
    typer.Option(metavar="MM", help="Reject bodies with a smaller static margin when printed, such as 20."),
]
_Buildable = Annotated[
    bool,
    typer.Option(
        "--buildable", help="Reject bodies that can fold, or that their motors cannot deform, when printed."
    ),
]
_SecondStage = Annotated[
    bool,
    typer.Option("--second-stage", help="Simulate survivors as printed robots; remove those that fall over."),
]
_Inherit = Annotated[
    bool, typer.Option("--inherit", help="Offspring start from the learned weights of their parent.")
]
_Optimiser = Annotated[
    Optimiser, typer.Option(help="Update rule: steps of one length as in the paper, or Adam.")
]
_UpdateLength = Annotated[
    float | None,
    typer.Option(
        help=f"Length of an update; with Adam, of the first one. Default: {UPDATE_LENGTHS['steps']:g}, "
        f"with Adam {UPDATE_LENGTHS['adam']:g}."
    ),
]
_Window = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="STEPS",
        help="Truncate gradients to windows of this many steps. Default: the whole rollout.",
    ),
]
_Iterations = Annotated[
    int, typer.Option(min=1, max=defaults.MAX_ITERATIONS, help="Learning updates of every robot.")
]
_Randomise = Annotated[
    str | None,
    typer.Option(
        metavar="SCENE",
        help="Randomise the physics: by a file of eldir calibrate dynamics, or unfilmed for the priors.",
    ),
]
_Encoding = Annotated[
    EncodingName,
    typer.Option(
        help="What of a body is inherited: every triangle and spring, or a network that paints them and "
        "the motors' phases by their places."
    ),
]
_Crossover = Annotated[
    Crossover,
    typer.Option(
        help="How two progenitors are combined into one offspring; neat: networks of --encoding cppn."
    ),
]
_Seed = Annotated[
    int, typer.Option(min=0, help="Random seed of the run; the same seed gives the same bytes.")
]
_Cluster = Annotated[
    bool,
    typer.Option("--cluster", help="Learn and simulate on the Ray cluster of RAY_ADDRESS or ray start."),
]
_AsJson = Annotated[bool, typer.Option("--json", help="Print the status of the run as JSON.")]
_Explain = Annotated[
    bool,
    typer.Option("--explain", help="Print which computations the engine skips in this run, and why."),
]


def evolve(
    context: typer.Context,
    *,
    out: _NewRun = None,
    resume: _Resume = None,
    objective: _Objective = defaults.OBJECTIVE,
    problem: _Problem = None,
    rig: _Rig = None,
    lattice: _Lattice = None,
    population: _Population = None,
    generations: _Generations = None,
    terrain: _Terrain = defaults.GROUND,
    precision: _Precision = PRECISION,
    max_motors: _MaxMotors = None,
    static_margin: _StaticMargin = None,
    buildable: _Buildable = False,
    second_stage: _SecondStage = False,
    inherit: _Inherit = False,
    optimiser: _Optimiser = OPTIMISER,
    update_length: _UpdateLength = None,
    window: _Window = None,
    iterations: _Iterations = ITERATIONS,
    randomise: _Randomise = None,
    encoding: _Encoding = defaults.ENCODING,
    crossover: _Crossover = defaults.CROSSOVER,
    seed: _Seed = defaults.SEED,
    cluster: _Cluster = False,
    device: Device = None,
    as_json: _AsJson = False,
    explain: _Explain = False,
) -> None:
    """Evolve bodies that learn to walk, and train each one by gradient descent.

    With --objective printed, bodies and heating gaits evolve together. Each robot is judged by the walk of
    samples of the printed robot: the mean less half the standard deviation, a fall counted as no walk.

    Ctrl-C stops the run when the robots that are learning are done. --resume continues a run that was stopped
    or killed; the result has the same bytes as an uninterrupted run. eldir status RUN prints its status.

    Example: eldir evolve --objective printed --out run --seed 1
    """
    from eldir.core.files import require_new

    require_new(out)
    from eldir_app.evolution_run import NewRunOptions, run_evolution

    select_device(device)
    if out is not None and resume is None:
        options = NewRunOptions(
            objective=objective,
            problem=problem,
            rig=rig,
            lattice=lattice,
            population=population,
            generations=generations,
            terrain=terrain,
            precision=precision,
            max_motors=max_motors,
            static_margin_m=None if static_margin is None else 1e-3 * static_margin,
            buildable=buildable,
            second_stage=second_stage,
            inherit=inherit,
            optimiser=optimiser,
            update_length=update_length,
            window=window,
            iterations=iterations,
            randomise=randomise,
            encoding=encoding,
            crossover=crossover,
            seed=seed,
        )
        run = _create_run(out, options, context)
    elif resume is not None and out is None:
        run = _open_run(resume, context)
    else:
        raise typer.BadParameter("give either --out RUN for a new run or --resume RUN to continue one")
    run_evolution(run, cluster, as_json, explain, new=resume is None)


def _open_run(path: Path, context: typer.Context) -> Run:
    """The run to continue. Raises `typer.BadParameter` for an option that would change it."""
    from eldir.evolution.designs import open_run
    from eldir.evolution.paper.run_folder import RunFolder

    if surplus := _options_except(context, _OPTIONS_OF_RESUME):
        raise typer.BadParameter(f"--resume keeps the run's own settings; remove {surplus}")
    run = open_run(path)
    if not isinstance(run, RunFolder) and (surplus := _options_except(context, _OPTIONS_OF_OTHER_RESUME)):
        raise typer.BadParameter(f"only runs in the paper's scene have {surplus}; remove it")
    return run


def _create_run(out: Path, options: NewRunOptions, context: typer.Context) -> Run:
    """A new run folder. Raises `typer.BadParameter` for options that do not fit the objective."""
    from eldir_app.evolution_run import create_paper_run, create_printed_run, create_problem_run

    if options.problem is not None:
        if surplus := _options_except(context, _OPTIONS_OF_PROBLEM):
            raise typer.BadParameter(f"--problem evolves what its class says; remove {surplus}")
        return create_problem_run(out, options, options.problem)
    if options.objective == "printed":
        if surplus := _options_except(context, _OPTIONS_OF_PRINTED):
            raise typer.BadParameter(f"--objective printed judges walks of printed robots; remove {surplus}")
        return create_printed_run(out, options)
    if options.rig is not None:
        raise typer.BadParameter("--rig is only for --objective printed; remove it")
    return create_paper_run(out, options)


def _options_except(context: typer.Context, allowed: set[str]) -> str:
    """The options on the command line that are not allowed, separated by commas."""
    surplus = [
        f"--{name.replace('_', '-')}"
        for name in context.params
        if name not in allowed
        and (source := context.get_parameter_source(name)) is not None
        and source.name == "COMMANDLINE"
    ]
    return ", ".join(surplus)
