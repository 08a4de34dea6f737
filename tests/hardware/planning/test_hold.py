"""Springs held warm by a schedule: within the guardian's limits, at the power that was asked for."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from eldir.errors import InputError
from eldir.lattice import Lattice
from eldir_app.commands.rig import rig as command
from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.log.reader import read_log
from eldir_hardware.planning.hold import MIN_PULSE, hold_schedule, hold_temperatures
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.rig.template import virtual_rig
from eldir_hardware.run.player import Player
from eldir_hardware.safety.compatibility import MismatchError, require_compatible
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.virtual.rig import VirtualRig
from tests.eldir.random_design import make_design
from tests.hardware.rigs_and_schedules import rig_with
from tests.hardware.virtual.piston_and_observer import Notes, Piston
from tests.raised import raises

DESIGN = make_design(3, Lattice(3, 6))
THERMAL = {"kind": "thermal", "opens_at_c": 85.0}


def bench(board: str = "mosfet", least_off: float = 0.5, **changes: object) -> Rig:
    """With thermal switches: a timer relay that allows a cold spring 6 s allows a warm one less."""
    values = rig_with(board={"kind": board}, **changes).model_dump() | {"cutoff": THERMAL}
    values["limits"]["min_off_s"] = least_off
    return Rig.from_json(values)


@pytest.mark.parametrize("board", ["lcus", "modbus", "mosfet"])
def test_springs_are_held_where_heat_and_loss_balance(board):
    """On any board, played with the guardian's limits. The timer of `modbus` has steps of 0.1 s."""
    rig = bench(board)
    if board == "modbus":
        rig = rig.model_copy(update={"board": rig.board.model_copy(update={"retriggerable": True})})
    schedule = hold_schedule(DESIGN, rig, 0.3, 90.0)
    usual, notes = rig.spring_parameters(), Notes()
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        played = Player(bank, schedule, rig, virtual.clock, [notes]).play()
        edges = [(e.t, e.closed) for e in virtual.emulator.contact_events if e.channel == 1]
        assert not any(virtual.emulator.contacts)
    assert 90 <= schedule.cycles * schedule.period_s < 90 + schedule.period_s
    on = sum(off - start for (start, _), (off, _) in zip(edges[::2], edges[1::2], strict=True))
    exact = 0.02 if board == "modbus" else 0.005
    assert on / (schedule.cycles * schedule.period_s) == pytest.approx(0.3, abs=exact)
    rests = [after - before for (before, closed), (after, _) in pairwise(edges) if not closed]
    assert min(rests) > 0.48 and len(rests) == schedule.cycles - 1
    balance = usual.ambient + 0.3 * float(usual.power(0.0)) / usual.loss
    late = [max(t) for at, t in notes.temperatures if 60 < at < 90]
    assert np.mean(late) == pytest.approx(balance, abs=2.0)
    assert np.ptp(late) < 8, "the ripple"
    assert played.peak_c < schedule.predicted.peak_c


@pytest.mark.parametrize(("power", "stroke"), [(0.1, 0.0), (0.3, 0.0), (0.45, 0.41)])
def test_what_is_foretold_lies_around_the_balance(power, stroke):
    """Of heat and loss, for springs whose resistance does not change; the ripple is that of one pulse."""
    rig = bench()
    usual = rig.spring_parameters()
    found = hold_temperatures(hold_schedule(DESIGN, rig, power, 60.0), rig, usual)
    balance = usual.ambient + power * float(usual.power(0.0)) / usual.loss
    assert found.min_c < balance < found.max_c < found.min_c + 8
    assert found.stroke == pytest.approx(stroke, abs=0.05)


@pytest.mark.parametrize(
    ("power", "least_off", "pulse", "pause"),
    [(0.25, 0.05, 0.5, 1.5), (0.25, 6.0, 2.0, 6.0), (0.4, 0.05, 0.5, 0.75), (0.1, 8.0, 0.889, 8.0)],
)
def test_pulses_are_as_short_as_the_rig_allows(power, least_off, pulse, pause):
    schedule = hold_schedule(DESIGN, bench(least_off=least_off), power, 60.0, [0])
    found = {(p.channel, round(p.start, 3), round(p.length, 3)) for p in schedule.pulses()}
    assert found == {(1, 0.0, pulse), (2, 0.0, pulse)}
    assert schedule.period_s == pytest.approx(pulse + pause, abs=1e-3)
    assert min(pulse, pause) >= MIN_PULSE


def test_no_limit_is_left_out():
    for rig, power, code in (
        (bench(), 0.7, "duty"),
        (bench(limits={"duty": 0.2}), 0.3, "duty"),
        (bench(limits={"duty": 1.0, "max_temperature_c": 65}), 0.5, "too-hot"),
        (bench(supply={"max_total_current_a": 7}), 0.3, "supply"),
        (bench(least_off=30.0), 0.3, "long-pulse"),
        (rig_with(limits={"min_off_s": 0.5}), 0.3, "stuck-contact"),
    ):
        with raises(LimitError, f"limit.{code}"):
            hold_schedule(DESIGN, rig, power, 60.0)
    assert hold_schedule(DESIGN, bench(supply={"max_total_current_a": 7.5}), 0.3, 60.0, [1]).channels == (
        3,
        4,
    )


@pytest.mark.parametrize(
    ("power", "seconds", "springs", "key"),
    [
        (0.0, 60, (), "power"), (1.0, 60, (), "power"), (float("nan"), 60, (), "power"),
        (0.3, 0.0, (), "time"), (0.3, float("inf"), (), "time"), (0.3, 1e6, (), "time"),
        (0.3, 60, (2,), "spring"), (0.3, 60, (-1,), "spring"),
    ],
)  # fmt: skip
def test_wrong_wishes_are_refused(power, seconds, springs, key):
    with raises(InputError, "input.wrong-value", key):
        hold_schedule(DESIGN, bench(), power, seconds, springs)


def run(*words: object):
    return CliRunner().invoke(command, [str(w) for w in words])


def test_a_user_holds_the_springs_of_a_virtual_rig(tmp_path: Path):
    """Both commands: the schedule is taken without a reason, and only by the rig that it was made for."""
    values = yaml.safe_load(virtual_rig(board="mosfet", design="design.json"))
    values["limits"] |= {"min_off_s": 0.5}
    values |= {"cutoff": THERMAL}
    values.pop("camera")
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(values))
    DESIGN.save(tmp_path / "design.json")
    files = [tmp_path / "design.json", "--rig", tmp_path / "rig.yaml", "--out", tmp_path / "hold.json"]
    made = run("hold", *files, "--power", "0.3", "--seconds", "20")
    assert made.exit_code == 0, made.output
    assert "springs are held at 39 to 45 C and at least 0% of their stroke; at most 59 C" in made.output
    assert "pulses of 0.5 s every 1.67 s, 12 times" in made.output
    driven = run("drive", tmp_path / "hold.json", *files[1:3], "--log", tmp_path / "log.mcap")
    assert driven.exit_code == 0, driven.output
    assert read_log(tmp_path / "log.mcap").statuses[-1][2] == "played to the end"
    schedule = ActuationSchedule.load(tmp_path / "hold.json")
    with pytest.raises(MismatchError, match="other values in supply"):
        require_compatible(schedule, bench(supply={"current_limit_a": 3.5}), None)
    again = run("hold", *files, "--power", "0.3")
    assert again.exit_code != 0 and "exists already" in str(again.exception)
