"""How well predicted walks transfer to MuJoCo: numbers, sentences, and the laws that a walk depends on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from eldir.built.gait import free_lengths
from eldir.built.robot import build
from eldir.built.walking import displacements
from eldir.core.records import Record, Rounded, record
from eldir.parameters.robot import RobotParameters
from eldir_cad.multibody.model import SIMPLIFICATIONS
from eldir_calibration.transfer.compared_walks import ComparedWalk, TransferConfig, WalkingDesign
from eldir_calibration.transfer.mujoco_walks import FINE_NUMERICS, measure_walk
from eldir_hardware.virtual.mujoco_body import sample_multibody

Goal = Literal["spearman", "right_sign", "coverage", "mean_error"]
GOALS: dict[Goal, tuple[float, float]] = {
    "spearman": (0.9, 1.0),
    "right_sign": (0.95, 1.0),
    "coverage": (0.85, 0.99),
    "mean_error": (0.0, 0.1),
}
"""Goal of each number of a `TransferAgreement`, from and to."""
_MIN_RANKED_WALKS = 3  # walks that can be ranked
_MIN_RELIABLE_WALKS = 10  # walks with which a rank correlation is still uncertain
_LARGE_YAW = np.radians(20.0)  # in five cycles: such a robot leaves the camera's plane

Share = Annotated[float, Rounded(9, ge=0, le=1)]
_MIN_DIFFERENCE = 0.05  # body lengths per five cycles: there is nothing to explain
STEPS_PER_EXPLANATION = 2 + len(SIMPLIFICATIONS)
"""Steps of the progress for each design."""


@record
class TransferAgreement(Record):
    """Agreement of some compared walks; unknown where there are too few: NaN, and null in a file."""

    walks: Annotated[int, Field(ge=0)]
    """Number of compared walks: designs with a gait."""
    spearman: Annotated[float, Rounded(9, ge=-1, le=1)]
    """Spearman's rank correlation of the mean walks."""
    right_sign: Share
    """Share of the walks whose mean goes in MuJoCo the way that was predicted."""
    coverage: Share
    """Share of the robots in MuJoCo that walk within the interval of their prediction, or fall where a sample
    fell too."""
    mean_error: Annotated[float, Rounded(9, ge=0)]
    """Mean absolute difference of the mean walks [body lengths per five cycles]."""

    @classmethod
    def of(cls, compared: Sequence[ComparedWalk]) -> TransferAgreement:
        """The agreement of these walks; a fall counts as no motion in means."""
        from scipy.stats import spearmanr  # a second, and few commands need it

        if not compared:
            return cls(0, np.nan, np.nan, np.nan, np.nan)
        predicted, there = np.array([one.means for one in compared]).T
        ranked = len(compared) >= _MIN_RANKED_WALKS and np.ptp(predicted) > 0 and np.ptp(there) > 0
        return cls(
            len(compared),
            float(np.clip(spearmanr(predicted, there).statistic, -1.0, 1.0)) if ranked else np.nan,
            float((np.sign(predicted) == np.sign(there)).mean()),
            float(np.concatenate([one.within_interval for one in compared]).mean()),
            float(np.abs(predicted - there).mean()),
        )


def rank_in_mujoco(compared: Sequence[ComparedWalk]) -> list[ComparedWalk]:
    """The designs, each in its own gait, by how far their robots walk in MuJoCo: as `eldir shortlist` ranks
    samples of the engine (`SampledWalks.fitness`)."""
    return sorted((one for one in compared if one.is_own_gait), key=lambda one: -one.mujoco.fitness)


@dataclass(frozen=True)
class TransferVerdict:
    """Agreement of all walks, of those without ties, and of those whose prediction ties make doubtful; and
    which design to build."""

    all_walks: TransferAgreement
    untied: TransferAgreement
    """Walks that are not flagged as ties."""
    tied: TransferAgreement
    """Walks that are."""
    ranked: tuple[ComparedWalk, ...] = ()
    """The designs as `rank_in_mujoco` orders them."""

    @classmethod
    def of(cls, compared: Sequence[ComparedWalk]) -> TransferVerdict:
        """The verdict on these walks."""
        untied = [one for one in compared if not one.tied]
        tied = [one for one in compared if one.tied]
        whole, without, with_ties = (TransferAgreement.of(walks) for walks in (compared, untied, tied))
        return cls(whole, without, with_ties, tuple(rank_in_mujoco(compared)))

    @property
    def goal_values(self) -> dict[Goal, float]:
        """The value for each of `GOALS`: direction and error of walks without ties, the others of all
        walks."""
        all_walks = self.all_walks
        return {
            "spearman": all_walks.spearman,
            "right_sign": self.untied.right_sign,
            "coverage": all_walks.coverage,
            "mean_error": self.untied.mean_error,
        }

    @property
    def reached(self) -> dict[Goal, bool | None]:
        """Whether each goal was reached; None where the number is not known."""
        return {
            name: bool(GOALS[name][0] <= round(value, 9) <= GOALS[name][1]) if np.isfinite(value) else None
            for name, value in self.goal_values.items()
        }

    @property
    def sentences(self) -> list[str]:
        """The verdict, a sentence for each number."""
        all_walks, untied, tied = self.all_walks, self.untied, self.tied
        flagged = f", {tied.walks} of them flagged as ties" if tied.walks else ""
        sentences = [f"{all_walks.walks} {'walk' if all_walks.walks == 1 else 'walks'} compared{flagged}."]
        if np.isfinite(all_walks.spearman):
            ranks = f"Order: Spearman's rank correlation of the mean walks is {all_walks.spearman:.2f}"
            sentences.append(f"{ranks} ({self._goal('spearman', 'at least 0.9')}).")
        else:
            sentences.append(f"Order: no rank correlation; that takes {_MIN_RANKED_WALKS} different walks.")
        if untied.walks:
            right = round(untied.right_sign * untied.walks)
            way = f"Direction: {right} of {untied.walks} walks go the predicted way"
            goal = self._goal("right_sign", "at least 95 %")
            sentences.append(f"{way} ({goal}){self._ties_clause}.")
        else:
            sentences.append("Direction: all walks are flagged as ties.")
        inside = f"Interval: {all_walks.coverage:.0%} of the robots in MuJoCo walk within the 95 % interval"
        sentences.append(f"{inside} of their prediction ({self._goal('coverage', '85 to 99 %')}).")
        if untied.walks:
            error = f"Error: the mean walks differ by {untied.mean_error:.2f} body lengths per five cycles"
            others = f"; those flagged as ties by {tied.mean_error:.2f}" if tied.walks else ""
            sentences.append(f"{error} on average ({self._goal('mean_error', 'at most 0.1')}){others}.")
        else:
            sentences.append(
                f"Error: flagged as ties, the mean walks differ by {tied.mean_error:.2f} on average."
            )
        if len(self.ranked) > 1:
            sentences.append(self._choice)
        if all_walks.walks < _MIN_RELIABLE_WALKS:
            sentences.append("These are few walks: compare more designs before you rely on the numbers.")
        return sentences

    @property
    def _choice(self) -> str:
        """Which design to build first, with the others behind it."""
        names = [f"{one.file} ({_describe_walks(one)})" for one in self.ranked]
        rule = "by the mean walk in MuJoCo less half the standard deviation"
        if self.ranked[0].mujoco.fitness > 0.0:
            return f"Build first, {rule}: {names[0]}; then {', '.join(names[1:])}."
        return f"Build none of these designs: none walks forward reliably ({rule}: {', '.join(names)})."

    @property
    def _ties_clause(self) -> str:
        if not self.tied.walks:
            return ""
        right = round(self.tied.right_sign * self.tied.walks)
        return f"; of those flagged as ties {right} of {self.tied.walks}"

    def _goal(self, name: Goal, bounds: str) -> str:
        if self.goal_values[name] > GOALS[name][1] and name == "coverage":
            return f"goal: {bounds}; more means that the intervals are wide"
        return f"goal: {bounds}, {'reached' if self.reached[name] else 'missed'}"


def _describe_walks(one: ComparedWalk) -> str:
    if not np.isfinite(one.mujoco.fitness):
        return "all fall"
    turns = f", turns by up to {np.degrees(one.largest_yaw):.0f} degrees in five cycles"
    return f"{one.mujoco.fitness:.2f}{turns if one.largest_yaw > _LARGE_YAW else ''}"


Number = Annotated[float, Rounded(9)]


@record
class ExplainedWalk(Record):
    """Walks of one nominal robot, with feet and slope of a seed; minus infinity: it falls."""

    file: str
    """Name of the design file."""
    seed: Annotated[int, Field(ge=0)]
    """Random seed of the feet and of the table's slope."""
    engine: Number
    """Walk in eldir's engine [body lengths per five cycles]; null: it falls."""
    mujoco: Number
    """Walk in MuJoCo with all its laws [body lengths per five cycles]; null: it falls."""
    without: dict[str, Number]
    """Walk in MuJoCo without each of its laws [body lengths per five cycles]; null: it falls."""

    @property
    def changes(self) -> dict[str, float]:
        """Change of the walk without each law [body lengths per five cycles]; NaN where a robot falls."""
        with np.errstate(invalid="ignore"):
            return {
                name: float(walk - self.mujoco) if np.isfinite([walk, self.mujoco]).all() else np.nan
                for name, walk in self.without.items()
            }

    @property
    def finding(self) -> str:
        """The finding, as a sentence."""
        if not np.isfinite([self.engine, self.mujoco]).all():
            return "it falls, so there is no difference to explain"
        difference = self.mujoco - self.engine
        statement = f"MuJoCo differs from the engine by {difference:+.2f}"
        remains = {n: abs(difference + c) for n, c in self.changes.items() if np.isfinite(c)}
        falls = [name for name, walk in self.without.items() if not np.isfinite(walk)]
        fallen = f"; it falls without {' or '.join(falls)}" if falls else ""
        nearest = min(remains, key=lambda n: remains[n], default=None)
        if abs(difference) < _MIN_DIFFERENCE:
            return f"MuJoCo and the engine differ by less than {_MIN_DIFFERENCE:g}{fallen}"
        if nearest is None or remains[nearest] > abs(difference) / 2:
            return f"{statement}; taking away one law alone does not explain half of that{fallen}"
        return f"{statement}, without {nearest} by {difference + self.changes[nearest]:+.2f}{fallen}"


def explain_walk(
    one: WalkingDesign,
    seed: int,
    settings: TransferConfig,
    progress: Callable[[str, float], None] = lambda _what, _done: None,
) -> ExplainedWalk:
    """Simulate the walk of a design's nominal robot in the engine, in MuJoCo, and in MuJoCo without each
    law."""
    body, ground = one.design.morphology, one.design.printed_terrain
    nominal = RobotParameters.nominal(settings.springs).printed
    sample = sample_multibody(body, seed, one.design.ballast, nominal, ground)
    model = replace(sample, numerics=FINE_NUMERICS)
    springs, cycles = settings.springs, settings.cycles
    table = free_lengths(one.gait, springs, cycles, hubs=body.motor_hubs)

    def report_step(what: str) -> None:
        progress(f"explaining {one.file}: {what}", 1)

    feet = np.array([hub.friction for hub in model.hubs]) / nominal.friction
    parameters = RobotParameters(nominal.with_hubs(), springs, feet=feet)
    robot = build(body, parameters, ballast=one.design.ballast / 2)
    free = springs.cold_length, springs.hot_length
    (engine,) = displacements([robot], [table], cycles, free, terrain=ground)
    report_step("MuJoCo")
    whole = measure_walk(model, body, table, cycles, springs).displacement
    report_step("one law less")
    without = {}
    for name, simpler in SIMPLIFICATIONS.items():
        without[name] = measure_walk(simpler(model), body, table, cycles, springs).displacement
        report_step(f"without {name}")
    return ExplainedWalk(one.file, seed, float(engine), whole, without)
