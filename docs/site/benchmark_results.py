"""Records of the files that benchmarks write. They collect their values one by one, without a record."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt

from eldir.core.kernels import Precision
from eldir.core.records import OMITTED, FileRecord, Record, record
from eldir.scene import Integrator

Share = Annotated[float, Field(ge=0, le=1)]


@record
class Machine(Record):
    """The machine on which the figures were measured."""

    processor: str
    """Name of the processor."""
    cores: int
    """Number of logical processors."""
    system: str
    """Operating system and its version."""
    other_programs: Share | None = None
    """Processor time of other programs during the measurement, as a share of that of all cores; above 0.1 the
    machine was busy. Null where the system does not tell."""

    OPTIONAL = frozenset({"other_programs"})


@record
class Benchmark(FileRecord):
    """Result of a benchmark."""

    version: str
    """Version of eldir that wrote the file."""
    machine: Machine
    """The machine on which the figures were measured."""


@record
class AccuracyPoint(Record):
    """One integrator, time step and precision."""

    name: str
    """Integrator, time step and precision in words."""
    integrator: Integrator
    """Integration scheme, as in the scene of a design."""
    dt: float
    """Time step [s]."""
    precision: Precision
    """Floating-point precision of the simulation."""
    ms_per_robot: float
    """Processor time of one thread for one robot, forward only [ms]; the shortest of three runs."""
    error: float
    """Median over robots of the root mean square over masses of the distance from the converged reference
    [m]; infinite where a robot blew up."""
    error_90: float
    """90th percentile over robots of the same distance [m]."""
    gradient_error: Annotated[float | None, OMITTED] = None
    """Median over robots of the length of the gradient's error, relative to the length of the reference
    gradient."""


@record
class AccuracyOfScene(Record):
    """Run time against error in one scene."""

    points: Annotated[tuple[AccuracyPoint, ...], Field(min_length=1)]
    """One point for every integrator, time step and precision."""
    pareto: tuple[int, ...]
    """Indices of the points that no other point beats in time and error_90, the fastest first."""
    cheapest: dict[str, str | None]
    """For each error [m], the name of the fastest point whose error_90 is below it; null: there is none."""


@record
class Accuracy(Benchmark):
    """Result of `eldir benchmark accuracy`."""

    FORMAT = "eldir-benchmark-accuracy/1"

    robots: PositiveInt
    """Number of robots in each scene."""
    seconds: float
    """Simulated time after which the errors are taken [s]."""
    scenes: Annotated[dict[str, AccuracyOfScene], Field(min_length=1)]
    """Results of each scene, by its name."""


@record
class SimplifiedWalks(Record):
    """Time and error of one simplification."""

    seconds_per_walk: PositiveFloat
    """Processor time of one walk on one thread, heat included [s]; median over turns."""
    walks_per_s: PositiveFloat
    """Walks in a second on one thread: one over seconds_per_walk [1/s]."""
    mean_difference: float
    """Mean over robots of the difference of the mean walk from that of the first simplification [body lengths
    per five cycles]."""
    rms_difference: NonNegativeFloat
    """Root mean square over robots of the same difference [body lengths per five cycles]."""


@record
class OtherWalks(SimplifiedWalks):
    """Time and error of another physics, over fewer samples and one turn. Its joints, strips and contacts are
    modelled differently: the difference is not its error alone."""

    samples: PositiveInt
    """Number of samples of each robot, the first of all."""


@record
class Built(Benchmark):
    """Result of `eldir benchmark built`."""

    FORMAT = "eldir-benchmark-built/1"
    OPTIONAL = frozenset({"others"})
    """What older files lack."""

    robots: PositiveInt
    """Number of robots that were simulated."""
    samples: PositiveInt
    """Number of samples of each robot."""
    turns: PositiveInt
    """Number of turns; every turn times all simplifications one after the other."""
    heat_s: NonNegativeFloat
    """Processor time of heating one robot's springs for one counted cycle [s]; median over turns."""
    ways: dict[str, SimplifiedWalks]
    """Results of each simplification, by its name; the first is exact."""
    others: dict[str, OtherWalks] = field(default_factory=dict)
    """Results of other physics that are installed, by name, against the exact walks of the same samples."""


@record
class Shortcut(Record):
    """Gain of one shortcut."""

    gain: float
    """Time without the shortcut over the time with it; median over turns."""
    difference: dict[str, float]
    """Greatest difference between both ways: loss [m], status, and gradient relative to the length of the
    gradient of W1."""


@record
class Skips(Benchmark):
    """Result of `eldir benchmark skips`."""

    FORMAT = "eldir-benchmark-skips/1"

    turns: int
    """Number of turns; every turn times both ways one after the other."""
    robots: int
    """Number of robots that were simulated."""
    skips: dict[str, Shortcut]
    """Results of each shortcut, by its name."""


@record
class Throughput(Record):
    """Time of learning on one thread."""

    springs: PositiveFloat
    """Mean number of springs of a robot."""
    iterations_per_s: PositiveFloat
    """Robots times learning iterations in a second, on one thread [1/s]."""
    us_per_step: float
    """Time of one robot and one step in a whole iteration: forward, backward and update [us]."""
    share: dict[str, float]
    """Time of a simpler task, as a part of a whole iteration: forward pass alone, open loop, passive
    robots."""
    ratio: dict[str, float]
    """Time of a harder task, as a multiple of a whole iteration: rugged ground, float64."""


@record
class Memory(Record):
    """Peak memory of a process with many robots."""

    robots: int
    """Number of robots."""
    engine_gb: float
    """Peak memory after one robot has learned, before the others exist [GB]."""
    bodies_gb: float
    """Peak memory when all bodies exist [GB]."""
    peak_gb: float
    """Peak memory after all robots have learned for one iteration of ten steps [GB]."""


@record
class Use(Record):
    """Processor time until a process has its first result."""

    start_s: float
    """Processor time until the engine has started [s]."""
    kernel_s: float
    """Processor time from then until one robot has learned over two steps [s]."""


@record
class FirstUse(Record):
    """Processor time until the first result."""

    compiled: Use
    """With an empty cache, so that the kernels are compiled."""
    cached: Use
    """In a second process, with the compiled kernels in the cache."""


@record
class Speed(Benchmark):
    """Result of `eldir benchmark speed`."""

    FORMAT = "eldir-benchmark-speed/1"

    steps: int
    """Time steps of a rollout."""
    iterations: int
    """Learning iterations that are timed together."""
    turns: int
    """Number of turns; every turn times all tasks one after the other."""
    big: Throughput
    """Results with large random bodies."""
    small: Throughput
    """Results with small random bodies."""
    scaling: dict[str, float]
    """Speed relative to one thread, by the number of threads."""
    memory: Memory
    """Peak memory of a process with many robots."""
    first_use: FirstUse
    """Processor time until the first result."""


@record
class DeviceThroughput(Record):
    """How fast robots learn on a device, over their number."""

    robots: tuple[int, ...]
    """Numbers of robots that learn at the same time."""
    iterations_per_s: tuple[float, ...]
    """Robot-iterations in a second for each of them, without packing and transfers."""


@record
class Generation(Record):
    """All learning updates of a generation, on a device."""

    robots: int
    """Number of robots."""
    iterations: int
    """Updates of each."""
    seconds: float
    """Time by the clock, with all transfers [s]."""
    packing_s: float
    """Time of initial weights and packing before [s]."""
    mean_loss_m: float | None
    """Mean loss after the last update [m]; null if a robot blew up."""


@record
class Device(Benchmark):
    """Result of `eldir benchmark speed --device`."""

    FORMAT = "eldir-benchmark-device/1"

    device: Literal["cuda", "vulkan"]
    """Interface to the device."""
    name: str
    """Name of the device."""
    compiler: Literal["taichi", "quadrants"]
    """The compiler of the kernels."""
    start_s: float
    """Time until the worker process has started the device [s]."""
    big: DeviceThroughput
    """Results with large random bodies."""
    small: DeviceThroughput
    """Results with small random bodies."""
    generation: Generation
    """All learning updates of a generation."""


@record
class StabilityPoint(Record):
    """Runs with one combination of settings."""

    stiffness: float
    """Stiffness of every spring, for masses of 1 kg [N/m]."""
    damping: float
    """Rate at which velocities decay [1/s]."""
    actuation: float
    """Greatest relative change of an active spring's rest length."""
    precision: Precision
    """Floating-point precision of the simulation."""
    steps: int
    """Number of time steps."""
    slope: float
    """Slope of the ground ahead of the robot; 0: level."""
    part: float
    """Time step of the run, as a part of the largest stable step."""
    largest_step: float
    """Largest stable time step by the prediction, mean over the bodies [s]."""
    lasted: Share
    """Share of the bodies that stayed finite and slow enough to be stable."""


@record
class ExtremeCase(Record):
    """An extreme body on an extreme ground."""

    body: str
    """Name of the extreme body."""
    ground: str
    """Name of the ground."""
    precision: Precision
    """Floating-point precision of the simulation."""
    status: Annotated[int, Field(ge=-2)]
    """Status of the rollout: -1 finished, -2 refused, otherwise the step at which the robot blew up."""
    flagged: bool
    """Whether all states and the loss are finite wherever the status says so."""
    alone: bool
    """Whether the result has the same bytes as without the other robots."""


@record
class RandomRobots(Record):
    """Random robots that learn for 35 iterations in the paper's scene."""

    robots: int
    """Number of random robots."""
    discarded: Share
    """Share of the robots that a run would discard."""
    why: dict[Literal["refused", "blown up", "jump"], int]
    """Number of discarded robots for each reason: refused, blown up, or a jump of the loss."""
    mean_best_fitness: float
    """Mean of the best fitness of the other robots [m]."""
    standard_error: float
    """Standard error of that mean [m]."""


@record
class Stability(Benchmark):
    """Result of `eldir benchmark stability`."""

    FORMAT = "eldir-benchmark-stability/1"

    map: Annotated[tuple[StabilityPoint, ...], Field(min_length=1)]
    """Runs on both sides of the predicted limit of stability, one entry for each combination of settings."""
    agreement: dict[str, Share]
    """Shares of stable runs below and above the predicted limit, for passive and acting robots."""
    edge: tuple[ExtremeCase, ...]
    """Extreme bodies on extreme grounds, one entry for each."""
    random: RandomRobots
    """Random robots that learn for 35 iterations in the paper's scene."""
