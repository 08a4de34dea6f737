"""Every number that an identification depends on, with its unit and its reason.

"z" is a parameter's normalised value: its distance from nominal in standard deviations of its prior. Decision
numbers refer to docs/decisions.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class IdentificationSettings:
    """How a robot is identified, and when the result is believed."""

    # Noise.
    camera_noise: float = 0.15e-3
    """Error of one coordinate of a mark, assumed before residuals are known [m]. A third of it is the least
    noise that a fit assumes."""
    rough_noise: tuple[float, float] = (3e-3, 2e-3)
    """Noise of shape, and of walk per second, before the first fit has measured them [m]: wide enough that
    no starting point is lost."""
    correlation_time: float = 10.0
    """Residuals may be correlated for this long [s]: half a heating cycle."""

    # Starting points.
    starts: int = 16
    """Robots tried first, the nominal one and draws from the prior: two groups of the engine's lanes."""
    start_limit: float = 2.0
    """Draws of z are clipped to this: nineteen in twenty lie inside."""
    followed: tuple[tuple[int, int], ...] = ((4, 5), (2, 6))
    """Stages of the search: how many of the best starting points go on, with how many evaluations each."""

    # Least squares.
    rounds: tuple[int, ...] = (6, 5, 5)
    """Evaluations of each round of a fit; noise and step widths are measured again between rounds."""
    joint_rounds: tuple[int, ...] = (4, 4, 3)
    """The same for hubs, which start where pins did and cost seven times as much."""
    part_rounds: tuple[int, ...] = (4, 4)
    """The same where every part gets parameters of its own."""
    z_limit: float = 3.0
    """No |z| may exceed this: 0.3 % of a normal prior lies outside."""
    loss_scale: float = 3.0
    """Residuals above this many standard deviations count linearly (soft L1): outliers, such as a mark that
    was mistaken for another one."""
    tolerance: float = 1e-3
    """Relative change of z and cost below which a round ends."""
    gradient_tolerance: float = 1e-6
    """Gradient of the cost below which a round ends."""
    lost_residual: float = 1e3
    """Residual of every frame in which a simulated robot blew up, in standard deviations: worse than any
    robot that did not."""

    # Slopes by central differences (decision 0021).
    step_widths: tuple[float, float] = (0.03, 0.8)
    """Least and greatest step of z: below, rounding and landings decide; above, the motion is not linear."""
    step_motion: float = 1e-3
    """A step should move the marks by this [m]: much, compared with what landings leave to chance."""
    first_step: float = 0.3
    """Step of z in the first round, when nothing was measured yet."""
    part_step: float = 1.0
    """The same for parameters of single parts, which move the marks less."""
    known_step: float = 1e-4
    """Step of z for the slopes of priors and readings, which are smooth."""
    jitter: float = 0.1
    """Slightly perturbed robots measure the chance in slopes: perturbed by this part of the step widths."""
    repeats: int = 1
    """How many of them: with fifteen parameters stepped to both sides, one fills four groups of lanes."""

    # Slightly perturbed robots: how far a motion can be predicted at all (decision 0025).
    perturbed: int = 7
    """Robots that differ slightly from the fitted one; with it they fill a group of the engine's lanes."""
    perturbation: float = 0.1
    """Size of the perturbation, as a part of the step widths: as far as a slope has to reach."""
    divergence_limit: float = 0.1e-3
    """Perturbed robots may differ by this, root mean square [m]: strips 0.3 mm off leave 0.13 mm, which must
    not be hidden."""
    divergence_window: float = 0.5
    """They are compared over this time to both sides of a frame [s]: a landing lasts about a second."""
    refits: int = 3
    """A film in which robots diverge is fitted again up to this many times, without these frames."""
    refit_share: float = 0.1
    """Part of the frames below which that is not worth it where the model fits."""
    refit_gain: float = 0.02
    """Part of the frames that a further fit must gain."""
    refit_near: float = 1.5
    """Fits that leave up to this multiple of the least are as good as the best one."""

    # Readings.
    weight_error: float = 0.005
    """Standard deviation of a weighed mass, relative."""
    meter_error: float = 0.005
    """Standard deviation of a current or voltage, relative."""

    # Does the model fit? (decision 0025)
    noise_share: float = 0.3
    """Correlated residuals up to this part of the tracks' noise count as none."""
    least_limit: float = 0.02e-3
    """Interpolation between instants and rounding leave this in any case [m]."""
    parts_share: float = 0.02
    """A model of every part may leave this part of the motion: no model of a real robot is exact."""
    judged_share: float = 0.9
    """Part of a cycle that must be left to judge whether a model fits."""
    held_out_factor: float = 1.5
    """Factor by which the limit is larger in the held-out cycle: errors grow with time."""
    reproducible_share: float = 0.9
    """Part of the cycle before the held-out one in which perturbed robots must agree, or the held-out cycle
    is no test."""
    explained_share: float = 0.5
    """Joints that leave at most this part of what the assumed ones left end the search for joints."""
    near_joints: float = 1.5
    """Parts get parameters of their own with joints that leave up to this multiple of what the best leave."""
    edge_share: float = 0.99
    """A parameter is at the edge of its range above this part of `z_limit`."""
    widening: float = 2.0
    """Intervals of a model that is only nearly right are wider by this factor: on trial they were too narrow
    by as much."""

    # What counts as known.
    known_share: float = 0.5
    """A quantity is identified where less than this part of its prior's standard deviation is left."""
    interval: float = 1.96
    """Half width of a 95 % interval, in standard deviations."""

    # Predictions.
    doubtful_range: float = 0.05
    """Relative error of the vertical ranges in a fitted cycle above which predictions are called doubtful."""
    doubtful_walk: float = 0.1
    """The same of the walk [body lengths per five cycles]."""

    # What films and fits are refused (`eldir_calibration.dynamics.requirements`).
    least_cycles: int = 2
    """Complete cycles in every film; the last one of the last film is held out."""
    least_marks: int = 3
    """Marks that must be seen: two do not determine the rotation of the body."""
    seen_share: float = 0.5
    """A mark counts as seen above this part of the frames."""
    least_motion: float = 2e-3
    """Least vertical range of the mark that moves most [m]: well above the camera's noise."""
    unexplained_share: float = 0.35
    """Part of the motion that a fit may leave; above, it was another robot."""

    # Messages.
    reported_gap: float = 5.0
    """Frames left out are reported above this time [s]: a single landing is not."""
    named_motions: int = 3
    """Motions that are named where a model does not fit."""

    # Identifiability (`eldir_calibration.dynamics.identifiability`).
    attribution_step: float = 0.3
    """Step of z for slopes of vertical ranges, and of films that were not made."""
    film_rate: float = 10.0
    """Frame rate of a film that was not made [1/s]."""


DEFAULT_SETTINGS = IdentificationSettings()
"""The settings of `eldir calibrate dynamics`."""
