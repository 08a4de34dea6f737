"""An evolution in the terminal: a new run, progress bar, Ctrl-C, the cluster, the engine's shortcuts."""

from __future__ import annotations

import json
import re
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import typer
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

from eldir.core.arguments import require_value
from eldir.core.version import warn_of_other_source
from eldir.errors import EldirError, print_line
from eldir.evolution.paper.run_folder import RunFolder
from eldir.evolution.printed.run_folder import PrintedRun
from eldir_app.progress import progress_bar

if TYPE_CHECKING:
    from pathlib import Path

    from eldir.core.kernels import Precision
    from eldir.defaults import Crossover, EncodingName, Objective, Optimiser
    from eldir.evolution.cluster import Cluster
    from eldir.evolution.designs import Run
    from eldir.evolution.own.run_folder import ProblemRun
    from eldir.evolution.printed.configuration import RejectionReason
    from eldir.evolution.search import Search
    from eldir.terrain import Terrain
    from eldir.training.configuration import TrainingConfig
    from eldir.training.randomisation import Randomisation


@dataclass(frozen=True, kw_only=True)
class NewRunOptions:
    """What the command line says about a new run. None: the default of the objective."""

    objective: Objective
    problem: str | None
    rig: Path | None
    lattice: str | None
    population: int | None
    generations: int | None
    terrain: str
    """A name of `eldir.defaults.Ground`, or a terrain file."""
    precision: Precision
    max_motors: int | None
    static_margin_m: float | None
    buildable: bool
    second_stage: bool
    inherit: bool
    optimiser: Optimiser
    update_length: float | None
    window: int | None
    iterations: int
    randomise: str | None
    encoding: EncodingName
    crossover: Crossover
    seed: int

    def shape(self, default: tuple[int, int]) -> tuple[int, int]:
        """Rows and columns of the lattice. Raises `typer.BadParameter` for another text than 13x22."""
        if self.lattice is None:
            return default
        match = re.fullmatch(r"([1-9]\d{0,2})x([1-9]\d{0,2})", self.lattice)
        if match is None:
            raise typer.BadParameter(
                f"--lattice: expected ROWSxCOLUMNS such as 13x22, found {self.lattice!r}"
            )
        return int(match[1]), int(match[2])

    def ground(self, robot: Literal["paper", "printed"], scale: float) -> Terrain | None:
        """The ground in metres of this robot; None: flat. Raises `typer.BadParameter` for another name,
        `InputError` for a file that is missing or damaged."""
        from eldir.defaults import Ground
        from eldir.evolution.paper.configuration import make_terrain
        from eldir.terrain import TerrainFile

        if self.terrain.endswith(".json"):
            terrain = TerrainFile.load(self.terrain).lengths_of(robot, scale)
            return None if terrain.is_flat else terrain
        for name in get_args(Ground):
            if name == self.terrain:
                drawn = None if name == "flat" else make_terrain(name, self.seed)
                return drawn.scaled(scale) if drawn is not None and robot == "printed" else drawn
        names = ", ".join(get_args(Ground))
        raise typer.BadParameter(
            f"--terrain: expected {names} or the name of a .json file, found {self.terrain!r}"
        )


def create_paper_run(out: Path, options: NewRunOptions) -> RunFolder:
    """A new run in the paper's scene."""
    from eldir import defaults
    from eldir.evolution.paper.configuration import EvolutionConfig
    from eldir.lattice import Lattice
    from eldir.parameters.printed import BuiltParameters
    from eldir.scene import Scene

    scene, ground = Scene.preset("paper"), options.ground("paper", BuiltParameters().scale)
    if ground is not None:
        scene = scene.replace(terrain=ground)
    config = EvolutionConfig(
        lattice=Lattice(*options.shape(defaults.LATTICE)),
        population=defaults.POPULATION if options.population is None else options.population,
        generations=defaults.GENERATIONS if options.generations is None else options.generations,
        max_active=options.max_motors,
        static_margin=options.static_margin_m,
        buildable=options.buildable,
        second_stage=options.second_stage,
        encoding=options.encoding,
        crossover=options.crossover,
        inherit=options.inherit,
        iterations=options.iterations,
        randomisation=None if options.randomise is None else _randomisation(options.randomise),
        seed=options.seed,
        scene=scene.replace(window=options.window, precision=options.precision),
        training=_training(options),
    )
    return RunFolder.create(out, config)


def create_printed_run(out: Path, options: NewRunOptions) -> PrintedRun:
    """A new run of printed robots. Raises `InputError` for too few robots, for more motors than the rig can
    heat or a body can have, and for a static margin below that of the build filter."""
    from eldir import defaults
    from eldir.evolution.printed.configuration import PrintedEvolutionConfig
    from eldir.lattice import Lattice
    from eldir_hardware.planning.workshop import make_workshop

    shape = options.shape(defaults.PRINTED_LATTICE)
    offspring = defaults.PRINTED_OFFSPRING if options.population is None else options.population
    fewest = defaults.MIN_PRINTED_OFFSPRING
    require_value("--population", offspring >= fewest, f"at least {fewest} printed robots", offspring)
    conditions = make_workshop(options.rig)
    motors = options.max_motors
    if motors is None:
        motors = min(conditions.motors, defaults.PRINTED_MOTORS)
    expected = f"at most {conditions.motors} on this rig"
    remedy = "add channels to the rig file, and give it with --rig"
    require_value("--max-motors", motors <= conditions.motors, expected, motors, remedy)
    expected = f"at most {conditions.buildable_motors}: bodies with more cannot be built"
    remedy = "leave the option out: the other channels of the rig stay off"
    require_value("--max-motors", motors <= conditions.buildable_motors, expected, motors, remedy)
    margin = defaults.PRINTED_MARGIN if options.static_margin_m is None else options.static_margin_m
    least = conditions.min_static_margin
    expected = f"at least {1e3 * least:g} mm: the build filter refuses bodies with less"
    remedy = "leave the option out, or give more"
    require_value("--static-margin", margin >= least, expected, f"{1e3 * margin:g} mm", remedy)
    config = PrintedEvolutionConfig(
        lattice=Lattice(*shape),
        offspring=offspring,
        generations=defaults.PRINTED_GENERATIONS if options.generations is None else options.generations,
        max_active=motors,
        static_margin=margin,
        seed=options.seed,
        printed=conditions.printed,
        springs=conditions.springs,
        timings=conditions.timings,
        tolerances=conditions.tolerances,
        terrain=options.ground("printed", conditions.printed.scale),
    )
    return PrintedRun.create(out, config)


def create_problem_run(out: Path, options: NewRunOptions, problem: str) -> ProblemRun:
    """A new run of an installed problem. Raises `InputError` where there is none of that name."""
    from eldir.evolution.own.registration import load_problem
    from eldir.evolution.own.run_folder import ProblemRun
    from eldir.evolution.own.vectors import ProblemConfig

    load_problem(problem)
    config = ProblemConfig(problem, seed=options.seed)
    if options.population is not None:
        config = replace(config, offspring=options.population)
    if options.generations is not None:
        config = replace(config, generations=options.generations)
    return ProblemRun.create(out, config)


def _training(options: NewRunOptions) -> TrainingConfig:
    from eldir.training.configuration import TrainingConfig

    if options.update_length is None:
        return TrainingConfig(options.optimiser)
    return TrainingConfig(options.optimiser, options.update_length)


def _randomisation(source: str) -> Randomisation:
    """From a scene file, or "unfilmed" for the priors."""
    from eldir.built.scene import PrintedScene
    from eldir.training.randomisation import Randomisation

    return Randomisation.unfilmed() if source == "unfilmed" else Randomisation.of(PrintedScene.load(source))


def run_evolution(run: Run, cluster: bool, as_json: bool, explain: bool = False, new: bool = False) -> None:
    """Evolve until the end or Ctrl-C, and print the status of the run. The folder of a new run is removed if
    it fails before a result is saved."""
    resume = f"continue with eldir evolve --resume {run.path}"
    with run.remove_if_empty() if new else nullcontext(), run.locked():
        warn_of_other_source(run.path, run.source)
        if explain and isinstance(run, RunFolder):
            _print_skips(run)
        finished = _evolve(run, cluster, resume)
    print_status(run, as_json)
    if not finished:
        print_line(f"stopped; {resume}")
        raise typer.Exit(130)


def _evolve(run: Run, cluster: bool, resume: str) -> bool:
    """Evolve with a progress bar until the end or Ctrl-C; return whether the run is finished. An error says
    how to `resume`."""
    from eldir.evolution.loop import run_generations

    learns = isinstance(run, RunFolder)
    boundary = "the robots that are learning are done" if learns else "this generation is complete"
    saved = "everything learned so far is saved" if learns else "the complete generations are saved"
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"), TimeRemainingColumn())
    with (
        _open_cluster(cluster) as machines,
        progress_bar(*columns, is_permanent=True) as bar,
        _stop_at_boundary(boundary) as is_stopped,
    ):
        complete = run.complete_generations()
        done = complete[-1][0] + 1 if complete else 0
        task = bar.add_task("", total=run.config.generations + 1, completed=done)

        search: Search[Any] = run.restore(*_conditions(run))

        def progress(share: float) -> None:
            bar.update(task, completed=search.generation + share, description=run.progress_line(search))

        try:
            run_generations(run, search, machines or run.workers(), is_stopped, progress)
        except EldirError as error:
            if not run.has_results:
                raise
            raise EldirError(str(error), remedy=f"{saved}: {resume}") from None
    return search.finished


def _conditions(run: Run) -> tuple[RejectionReason, ...]:
    """Conditions on robots that the run folder does not contain: the build filter with the run's springs."""
    from eldir_hardware.planning.workshop import make_build_filter

    return (make_build_filter(run.config.springs),) if isinstance(run, PrintedRun) else ()


def print_status(run: Run, as_json: bool) -> None:
    """Print the status of a run, on one line or as JSON."""
    from eldir.evolution.status import read_status

    status = read_status(run)
    print(json.dumps(status.to_json(), indent=1) if as_json else f"{status.path}: {status.summary()}")


def _print_skips(run: RunFolder) -> None:
    """Print which computations the engine skips for the bodies of the next generation, and why."""
    from eldir.engine.shortcuts import SkippedWork, explain_skips
    from eldir.evolution.paper.learning import LearningBatch

    search = run.restore()
    batch = search.ask()
    assert isinstance(batch, LearningBatch)  # a generation begins with it
    why = f"{len(search.archive)} so far keep the results of their first generation"
    skips = explain_skips(batch.bodies, run.config.scene, backward=True, record=False)
    for skip in (*skips, SkippedWork("learning of survivors", why)):
        print(f"left out: {skip.work}: {skip.reason}", file=sys.stderr)


@contextmanager
def _open_cluster(cluster: bool) -> Iterator[Cluster | None]:
    """The Ray cluster; None for this computer alone."""
    if not cluster:
        yield None
        return
    from eldir.evolution.cluster import Cluster

    machines = Cluster()
    try:
        yield machines
    finally:
        machines.close()


@contextmanager
def _stop_at_boundary(boundary: str) -> Iterator[Callable[[], bool]]:
    """Yield a function that tells whether SIGINT or SIGTERM has arrived, so that the run stops where no
    result is lost. A second signal interrupts at once. `boundary`: what is completed first, in words."""
    requested = False

    def request_stop(signum: int, frame: object) -> None:
        nonlocal requested
        if requested:
            raise KeyboardInterrupt
        requested = True
        print(
            f"the run stops when {boundary}; press Ctrl-C again to stop at once, without their results",
            file=sys.stderr,
        )

    previous = {number: signal.signal(number, request_stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: requested
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
