"""Configuration of an identification: every number, with its unit and its reason.

"z" is a parameter's normalised value: its distance from nominal in standard deviations of its prior. Decision
numbers refer to docs/decisions.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class IdentificationConfig:
    """Parameters of the fit, and the limits for its result."""

    # Noise.
    camera_noise: float = 0.15e-3
    """Error of one coordinate of a marker, assumed before residuals are known [m]. A third of it is the least
    noise that a fit assumes."""
    rough_noise: tuple[float, float] = (3e-3, 2e-3)
    """Noise of shape, and of walk per second, before the first fit has measured them [m]: wide enough that
    no starting point is lost."""
    correlation_time: float = 10.0
    """Residuals may be correlated for this long [s]: half a heating cycle."""

    # Starting points.
    starts: int = 16
    """Number of starting points, the nominal robot and samples of the prior: two groups of the engine's
    lanes."""
    start_limit: float = 2.0
    """Samples of z are clipped to this: nineteen in twenty lie inside."""
    refinement_stages: tuple[tuple[int, int], ...] = ((4, 5), (2, 6))
    """Stages of the search: how many of the best starting points go on, with how many evaluations each."""

    # Least squares.
    rounds: tuple[int, ...] = (6, 5, 5)
    """Evaluations of each round of a fit; noise and step widths are measured again between rounds."""
    joint_rounds: tuple[int, ...] = (4, 4, 3)
    """The same for hubs, which start where pins did and cost seven times as much."""
    part_rounds: tuple[int, ...] = (4, 4)
    """The same where every part gets parameters of its own."""
    z_limit: float = 3.0
    """No z may exceed this in magnitude: 0.3 % of a normal prior lies outside."""
    loss_scale: float = 3.0
    """Residuals above this many standard deviations count linearly (soft L1): outliers, such as a marker that
    was mistaken for another one."""
    tolerance: float = 1e-3
    """Relative change of z and cost below which a round ends."""
    gradient_tolerance: float = 1e-6
    """Gradient of the cost below which a round ends."""
    diverged_residual: float = 1e3
    """Residual of every frame in which a simulated robot blew up, in standard deviations: worse than any
    robot that did not."""

    # Tangents by central differences (decision 0021).
    step_widths: tuple[float, float] = (0.03, 0.8)
    """Least and greatest step of z: below, rounding and diverging landings dominate; above, the motion is not
    linear."""
    step_motion: float = 1e-3
    """A step should move the markers by this [m]: much more than diverging landings do."""
    first_step: float = 0.3
    """Step of z in the first round, when nothing was measured yet."""
    part_step: float = 1.0
    """The same for parameters of single parts, which move the markers less."""
    prior_step: float = 1e-4
    """Step of z for the derivatives of priors and readings, which are smooth."""
    jitter: float = 0.1
    """Perturbation of the robots that measure divergence in the tangents, as a part of the step widths."""
    jitter_robots: int = 1
    """Number of these robots: with fifteen parameters stepped to both sides, one fills four groups of
    lanes."""

    # Slightly perturbed robots: how far a motion can be predicted at all (decision 0025).
    perturbed_robots: int = 7
    """Robots that differ slightly from the fitted one; with it they fill a group of the engine's lanes."""
    perturbation: float = 0.1
    """Size of the perturbation, as a part of the step widths: the range of a tangent."""
    divergence_limit: float = 0.1e-3
    """Perturbed robots may differ by this, root mean square [m]: strips 0.3 mm off leave 0.13 mm, which must
    not be hidden."""
    divergence_window: float = 0.5
    """They are compared over this time to both sides of a frame [s]: a landing lasts about a second."""
    refits: int = 3
    """A film with diverging frames is fitted again up to this many times without them."""
    refit_share: float = 0.1
    """Share of diverging frames below which a model that fits is not fitted again."""
    refit_gain: float = 0.02
    """Share of the frames that a further fit must gain."""
    refit_tolerance: float = 1.5
    """Fits that leave up to this multiple of the least are as good as the best one."""

    # Readings.
    weight_error: float = 0.005
    """Standard deviation of a weighed mass, relative."""
    meter_error: float = 0.005
    """Standard deviation of a current or voltage, relative."""

    # Whether the model fits (decision 0025).
    noise_share: float = 0.3
    """Correlated residuals up to this part of the tracks' noise count as none."""
    min_limit: float = 0.02e-3
    """Interpolation between instants and rounding leave this in any case [m]."""
    part_tolerance: float = 0.02
    """A model of every part may leave this part of the motion: no model of a real robot is exact."""
    min_judged_share: float = 0.9
    """Part of a cycle that must be left to judge whether a model fits."""
    held_out_factor: float = 1.5
    """Factor by which the limit is larger in the held-out cycle: errors grow with time."""
    min_reproducible_share: float = 0.9
    """Part of the cycle before the held-out one in which perturbed robots must agree, or the held-out cycle
    is no test."""
    joint_gain_share: float = 0.5
    """Joints that leave at most this part of what the assumed ones left end the search for joints."""
    joint_tolerance: float = 1.5
    """Parts get parameters of their own with joints that leave up to this multiple of what the best leave."""
    edge_share: float = 0.99
    """A parameter is at the edge of its range above this part of `z_limit`."""
    widening: float = 2.0
    """Intervals of a model that is only nearly right are wider by this factor: on trial they were too narrow
    by as much."""

    # What counts as identified.
    max_known_spread: float = 0.5
    """A quantity is identified where less than this part of its prior's standard deviation is left."""
    interval: float = 1.96
    """Half width of a 95 % interval, in standard deviations."""

    # Predictions.
    max_range_error: float = 0.05
    """Relative error of the vertical ranges in a fitted cycle above which predictions are called doubtful."""
    max_walk_error: float = 0.1
    """The same of the walk [body lengths per five cycles]."""

    # Requirements on films and fits.
    min_cycles: int = 2
    """Complete cycles in every film; the last one of the last film is held out."""
    min_markers: int = 3
    """Markers that must be seen: two do not determine the rotation of the body."""
    min_visible_share: float = 0.5
    """A marker counts as seen above this part of the frames."""
    min_motion: float = 2e-3
    """Least vertical range of the marker that moves most [m]: well above the camera's noise."""
    max_unexplained_share: float = 0.35
    """Part of the motion that a fit may leave; above, it was another robot."""

    # Messages.
    min_reported_gap: float = 5.0
    """Excluded frames are reported above this time [s]: a single landing is not."""
    max_named_motions: int = 3
    """Motions that are named where a model does not fit."""

    # Identifiability (`eldir_calibration.dynamics.identifiability`).
    attribution_step: float = 0.3
    """Step of z for derivatives of vertical ranges, and of planned films."""
    film_rate: float = 10.0
    """Frame rate of a planned film [1/s]."""


DEFAULT_CONFIG = IdentificationConfig()
"""The settings of `eldir calibrate dynamics`."""
