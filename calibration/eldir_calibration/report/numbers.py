"""Every number of a report: the file report.json."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated, Any

from pydantic import Field

from eldir.core.records import OMITTED, FileRecord, Record, Rounded, record
from eldir.parameters.wiring import Connection, Wiring, is_in_series, wiring, wiring_digest
from eldir_calibration.report.comparison import Agreement, CycleMean
from eldir_calibration.report.controls import OtherDesigns
from eldir_calibration.report.verdict import (
    HORIZONTAL_SWING,
    VERTICAL_RANGE,
    AgreementLevel,
    ComparedQuantity,
    MarkerMotion,
    ReportVerdict,
    RobotLoss,
)
from eldir_hardware.vision.tracking_quality import TrackingQuality

Number = Annotated[float, Rounded(9)]
Size = Annotated[float, Rounded(9, ge=0)]
Interval = tuple[Number, Number]


def to_interval(estimate: CycleMean) -> Interval:
    """Both ends of the interval of an estimate."""
    return estimate.low, estimate.high


@record
class ComparedNumbers(Record):
    """One quantity, predicted and filmed."""

    predicted: Number
    """Mean of the samples that stay upright."""
    predicted_interval: Interval
    """95 % for one more robot."""
    nominal: Number
    """Prediction for the nominal robot, or for the most probable one."""
    tracked: Number
    """Filmed value; null if unknown."""
    tracked_interval: Interval
    """95 % over cycles; wider for a robot that left its plane."""
    agreement: AgreementLevel | None
    """agrees: the film lies within the prediction's interval; undecided: only its own interval reaches
    inside, the prediction was fitted to this film, or the robot was lost before the end of the run;
    disagrees; null: unknown."""

    @classmethod
    def entries(cls, one: ComparedQuantity) -> dict[str, Any]:
        """The entries of one quantity."""
        return {
            "predicted": one.predicted.mean,
            "predicted_interval": to_interval(one.predicted),
            "nominal": one.nominal,
            "tracked": one.tracked.mean,
            "tracked_interval": to_interval(one.tracked),
            "agreement": one.agreement,
        }


@record
class _MarkerNumbers(Record):
    """Which motion of which marker."""

    mark: str
    """Name of the marker."""
    motion: Annotated[str, Field(json_schema_extra={"enum": [VERTICAL_RANGE, HORIZONTAL_SWING]})]
    """Which motion of the marker."""


@record
# In the file, the entries of the last base are the first.
class MotionNumbers(ComparedNumbers, _MarkerNumbers):
    """The size of the motion of one marker in one direction [m], predicted and filmed."""

    @classmethod
    def of(cls, one: MarkerMotion) -> MotionNumbers:
        """The motion of one marker."""
        return cls(mark=one.marker, motion=one.quantity, **cls.entries(one))


@record
class VerdictNumbers(Record):
    """The main finding: the film against samples of the uncertain robot."""

    text: str
    """The finding in words."""
    samples: Annotated[int, Field(ge=0)]
    """Number of sampled robots; 0: nothing was sampled and nothing is decided."""
    fell: Annotated[int, Field(ge=0)]
    """Samples that fell, folded or buckled a coil."""
    body_lengths_per_5_cycles: ComparedNumbers
    """The walk [body lengths per five cycles]."""
    motions_m: tuple[MotionNumbers, ...]
    """Vertical range and horizontal swing of every marker [m]."""
    largest_disagreement: MotionNumbers | None
    """The motion that disagrees most [m]; null if none can be compared."""

    @classmethod
    def of(cls, verdict: ReportVerdict) -> VerdictNumbers:
        """The numbers of a verdict."""
        walk = ComparedNumbers(**ComparedNumbers.entries(verdict.walk))
        motions = tuple(map(MotionNumbers.of, verdict.motions))
        worst = None if verdict.worst is None else MotionNumbers.of(verdict.worst)
        return cls(verdict.text, verdict.samples, verdict.fell, walk, motions, worst)


@record
class MassNumbers(Record):
    """Motion of one marked mass. Each range is given for the simulated, predicted and tracked motion."""

    vertical_range_m: dict[str, Size]
    """Greatest minus least height in a cycle, mean over cycles [m]."""
    vertical_range_interval_m: dict[str, Interval]
    """95 % confidence interval over cycles (Student's t) [m]; of the prediction, for one more robot, from
    samples."""
    vertical_range_body_lengths: dict[str, Size]
    """The same range in body lengths, of each motion."""
    agreement_with_camera: dict[str, dict[str, Agreement]]
    """Agreement of the simulated and the predicted motion with the camera, horizontal and vertical."""
    seen: Annotated[float, Rounded(9, ge=0, le=1)]
    """Share of frames."""


@record
class RunNumbers(Record):
    """One log."""

    log: str
    """Name of the log file."""
    robot: str
    """`intact`, or how the robot differs from its design."""
    detail: str
    """Detail, such as which motor is missing; empty for the intact robot."""
    tracked: Number
    """Filmed displacement [body lengths per five cycles]."""
    tracked_interval: Interval
    """95 % interval of the filmed displacement over cycles; wider for a robot that left its plane."""
    predicted: Number
    """Predicted displacement of this robot under its schedule [body lengths per five cycles]."""
    cycles: Annotated[int, Field(ge=1)]
    """Number of cycles that count."""
    fingerprint: Annotated[str | None, Field(pattern="^[0-9a-f]{64}$"), OMITTED] = None
    """SHA-256 of the log's size and of its last 64 KiB."""
    loss: Annotated[RobotLoss | None, OMITTED] = None
    """When the robot fell or got out of sight before the end of the run; missing where it did not, and in
    older files."""


@record
class WiringNumbers(Record):
    """Which relay channel heated which spring."""

    sha256: str
    """As in the packet's manifest."""
    as_packet: bool
    """Whether packets say the same."""
    channels: tuple[Connection, ...]
    """Each relay channel that heats a spring."""

    @classmethod
    def of(cls, wired: Wiring) -> WiringNumbers:
        """The numbers of a map that heats one spring or more."""
        digest = wiring_digest(wired)
        packet = wiring(1 + max(c.spring for c in wired), in_series=is_in_series(wired))
        return cls(digest, digest == wiring_digest(packet), wired)


@record
class PredictionErrors(Record):
    """A prediction, and its errors compared with the camera."""

    vertical_range_m: dict[str, Size]
    """Predicted vertical range of each marker, mean over cycles [m]."""
    vertical_range_error: Number
    """Mean over masses, as a part of the camera's mean range."""
    height_error_m: Number
    """Root mean square error of the markers' heights over a mean cycle [m]."""
    body_lengths_per_5_cycles: Number
    """Predicted displacement [body lengths per five cycles]."""


@record
class IdentificationGain(Record):
    """The prediction before and after `eldir calibrate dynamics`."""

    before: PredictionErrors
    """Errors of the nominal robot's prediction."""
    after: PredictionErrors
    """Errors of the identified robot's prediction."""


@record
class OutOfPlaneNumbers(Record):
    """How far the robot was out of its plane of motion, as far as its markers tell: low, median and high of
    95 %."""

    yaw_deg: tuple[Number, Number, Number]
    """Rotation about the vertical at the end of the cycles that count, to either side [degrees]."""
    lean_deg: tuple[Number, Number, Number]
    """Lean to either side [degrees]: what it reaches in a quarter of these cycles by low end and median, and
    the largest high end."""
    depth_share: tuple[Number, Number, Number]
    """Distance of the markers behind the plane at the end, as a share of the camera's distance; negative
    where they are nearer to the camera."""
    walk_error: Size
    """By how much the filmed walk may be wrong because of these [body lengths per five cycles]."""
    certain: bool
    """Whether the markers show that it left the plane; false where they agree with a robot in its plane."""
    last_seen_s: Annotated[float, Rounded(3, ge=0)] | None
    """When all markers vanished for good [s]; null where they did not. Only cycles before it count."""
    fell: bool
    """Whether the markers show that it fell over sideways then."""

    @property
    def certain_walk_error(self) -> float:
        """The error that counts [body lengths per five cycles]: 0 where the markers agree with a robot in its
        plane."""
        return self.walk_error if self.certain else 0.0


@record
class ReportNumbers(FileRecord):
    """Written by `eldir report` as report.json. Lengths in metres at the built robot's pitch; null where
    the film does not show it."""

    FORMAT = "eldir-report/1"

    verdict: VerdictNumbers
    """The main finding: the film against samples of the uncertain robot."""
    masses: dict[str, MassNumbers]
    """Marked masses, m1 lowest."""
    body_lengths_per_5_cycles: dict[str, Number]
    """Mean forward motion of the marked masses: simulated, learned in the paper's scene; predicted for the
    printed robot; tracked, filmed, null if unknown."""
    body_lengths_per_5_cycles_interval: dict[str, Interval]
    """95 % of each motion: over cycles; of the prediction, for one more robot, from samples."""
    paper_body_lengths_per_5_cycles: dict[str, float]
    """Displacement of the paper's robot (Sect. Sim2Real), simulated and tracked."""
    runs: tuple[RunNumbers, ...]
    """Every log; body lengths per five cycles."""
    other_designs: OtherDesigns | None
    """Other bodies with as many motors under the same schedule: the agreement by chance."""
    tracking: TrackingQuality | None
    """Quality of the tracked motion; null if nothing was tracked."""
    body_length_m: Annotated[float, Rounded(9, ge=0)]
    """Body length of the built robot [m]."""
    wiring: WiringNumbers | None
    """Which relay channel heated which spring; null if unknown."""
    warnings: tuple[str, ...]
    """Warnings for the reader, as sentences."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Origin of the report, for the reader: versions, files, seeds."""
    identification: Annotated[IdentificationGain | None, OMITTED] = None
    """The prediction before and after `eldir calibrate dynamics`; only with --scene."""
    out_of_plane: Annotated[OutOfPlaneNumbers | None, OMITTED] = None
    """How far the robot was out of its plane; only if a strip joins two of its markers."""
