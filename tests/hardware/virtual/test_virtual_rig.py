"""The virtual rig through its real driver: heat follows contacts, and everything ends off."""

import time

import numpy as np
import pytest

from eldir.built.heat import heat
from eldir.errors import EldirError
from eldir_hardware.clock import VirtualClock
from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.relay.errors import ContactError, RelayError
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.run import drive
from eldir_hardware.run.player import Player
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.virtual.bodies import far_robot, find_parameters
from eldir_hardware.virtual.rig import VirtualRig
from eldir_hardware.virtual.springs import STEP
from tests.hardware.rigs_and_schedules import gait, rig_with
from tests.hardware.virtual.piston_and_observer import Notes, Piston
from tests.raised import raises


def play(rig: Rig, schedule: ActuationSchedule, meddle=lambda virtual: None) -> tuple[VirtualRig, Notes]:
    notes = Notes()
    with VirtualRig(rig, Piston()) as virtual:
        player = Player(
            PulseController(virtual.board, rig, virtual.clock), schedule, rig, virtual.clock, [notes]
        )
        virtual.start = virtual.clock.now() + 1.0
        virtual.watch(10.0, notes.frames.append)
        meddle(virtual)
        try:
            notes.played = player.play(virtual.start)
        except EldirError as error:
            notes.error = error
    return virtual, notes


@pytest.fixture(scope="module")
def played():
    begun = time.monotonic()
    schedule = compile_schedule(gait(), rig_with())
    virtual, notes = play(rig_with(), schedule)
    return schedule, virtual, notes, time.monotonic() - begun


def test_five_cycles_take_seconds(played):
    schedule, _, notes, wall = played
    assert schedule.duration == 123 and wall < 20
    assert notes.played.max_delay_s < 1e-6


def test_contacts_move_as_scheduled(played):
    schedule, virtual, _, _ = played
    wanted = [
        (t, channel, on) for t, changes in schedule.switchings() for channel, on in sorted(changes.items())
    ]
    edges = sorted(virtual.emulator.contact_events, key=lambda e: (round(e.t), e.channel))
    assert [(e.channel, e.closed) for e in edges] == [(c, on) for _, c, on in wanted]
    delays = np.array([e.t - virtual.start - t for e, (t, _, _) in zip(edges, wanted, strict=True)])
    assert np.abs(delays).max() < 0.0022, "sent ahead by wire and contact time; two frames take 4 ms each"
    assert virtual.emulator.contacts == (False,) * 4


def test_what_switched_is_read_back_at_once(played):
    """So a contact that does not open is known before its spring is much hotter."""
    schedule, _, notes, _ = played
    for t, changes in schedule.switchings():
        for channel, on in changes.items():
            seen = next(s for s, states in notes.relays if s > t and states[channel - 1] == on)
            assert seen - t < 0.15, (t, channel)


def test_springs_are_heated_by_the_contacts(played):
    schedule, virtual, notes, _ = played
    times = np.array([f.time_s for f in notes.frames])
    assert np.allclose(np.diff(times), 0.1) and times[0] == 0 and times[-1] >= schedule.duration - 0.1
    # The same springs heated by the recorded edges, integrated by other means, give the same lengths.
    dt = 0.005
    grid = virtual.start + dt * np.arange(round(schedule.duration / dt))
    on = np.zeros((len(grid), 2))
    for column, channel in enumerate((1, 2)):
        for edge in (e for e in virtual.emulator.contact_events if e.channel == channel):
            on[grid >= edge.t, column] = edge.closed
    lengths = heat(on, dt, virtual.springs.parameters[:2]).length.mean(axis=1)
    seen = np.array([f.positions[1, 0] for f in notes.frames])
    expected = np.interp(times, grid - virtual.start, lengths)
    inside = (times > 1) & (times < schedule.duration - 1)
    assert np.abs(seen - expected)[inside].max() < 1e-3
    assert np.sqrt(np.mean((seen - expected)[inside] ** 2)) < 2e-4


def test_modelled_temperatures_are_near_but_not_the_true_ones(played):
    _, virtual, notes, _ = played
    # The rig is within its tolerances; springs that have transformed get hot fast.
    assert abs(notes.played.peak_c - virtual.springs.max_temperature_c) < 20
    assert notes.played.peak_c != pytest.approx(virtual.springs.max_temperature_c, abs=1e-3)
    assert virtual.springs.max_temperature_c < 90
    model = np.array([t for _, t in notes.temperatures])
    assert model.max() == pytest.approx(notes.played.peak_c, abs=3)


def test_a_board_that_times_its_pulses_plays_the_same_schedule(played):
    schedule = compile_schedule(gait(), rig_with(), cycles=1)
    virtual, notes = play(rig_with(board={"kind": "modbus", "retriggerable": True}), schedule)
    assert len(virtual.emulator.contact_events) == 2 * 8
    heated = {}
    for edge in virtual.emulator.contact_events:
        heated[edge.channel] = heated.get(edge.channel, 0.0) + (-edge.t if edge.closed else edge.t)
    assert list(heated.values()) == pytest.approx([2 * 5.5] * 4, abs=0.05)
    assert notes.played.peak_c == pytest.approx(played[2].played.peak_c, abs=1.0)


def test_the_seed_decides():
    schedule = compile_schedule(gait(), rig_with(), cycles=1)
    first, again, other = (play(rig_with(virtual={"seed": s}), schedule)[1].frames for s in (1, 1, 2))
    assert all(np.array_equal(a.positions, b.positions) for a, b in zip(first, again, strict=True))
    assert any(not np.allclose(a.positions, b.positions) for a, b in zip(first, other, strict=True))


# Faults: whatever happens, everything that can be switched off is, and no spring passes the ceiling.


def test_a_far_rig_has_springs_of_its_own():
    """Their length, cold, is the far robot's, but for the scatter of one millimetre between its springs."""
    far = rig_with(virtual={"seed": 5, "parameter_spread": "large"})
    springs = far_robot(far).springs
    with VirtualRig(far, Piston(), springs) as virtual:
        frame = virtual.frame(virtual.clock.now() + 0.1)
    length = frame.positions[1, 0]
    assert (
        abs(length - springs.cold_length)
        < 3e-3
        < abs(springs.cold_length - far.springs.cold_length_mm * 1e-3)
    )


def test_springs_of_a_virtual_rig_are_as_alike_as_its_file_says():
    """The file's tolerances are bounds of two standard deviations; the usual springs differ by 2 and 4 %."""

    def deviations(**changes):
        rigs = [rig_with(virtual={"seed": seed}, **changes) for seed in range(30)]
        springs = [
            (r.spring_parameters(), s) for r in rigs for s in VirtualRig(r, Piston()).springs.parameters
        ]
        pairs = [(s.resistance / n.resistance, s.convection_fan / n.convection_fan) for n, s in springs]
        return np.abs(np.array(pairs) - 1).max(axis=0)

    narrow = {"springs": {"resistance_tolerance": 0.01}, "tolerances": {"convection_tolerance": 0.02}}
    assert deviations(**narrow) == pytest.approx([0.01, 0.02])
    assert (deviations() > [0.035, 0.1]).all()


def test_the_file_decides_whether_the_robot_is_far():
    """As `eldir rig drive` and the ROS node take it: other parts and other springs."""
    near, far = (rig_with(virtual={"seed": 5, "parameter_spread": spread}) for spread in ("small", "large"))
    assert find_parameters(near) == (None, near.spring_parameters())
    robot = far_robot(far)
    assert find_parameters(far) == (robot.printed, robot.springs)
    assert abs(robot.printed.hot_stiffness / near.nominal_robot().printed.hot_stiffness - 1) > 0.02
    assert robot.springs != near.spring_parameters()


def test_springs_of_a_far_rig_are_far_without_a_robot_too(monkeypatch):
    opened = []
    monkeypatch.setattr(drive, "VirtualRig", lambda *given: opened.append(VirtualRig(*given)) or opened[-1])
    far = rig_with(virtual={"seed": 5, "parameter_spread": "large"})
    with drive.open_bank(far):
        found = np.mean([s.hot_length for s in opened[0].springs.parameters])
    assert abs(found - far_robot(far).springs.hot_length) < 6e-3 < found - far.spring_parameters().hot_length


@pytest.mark.parametrize(("tolerance", "measured"), [(0.05, False), (0.02, True)])
def test_a_far_rig_has_the_current_of_its_file_where_that_was_measured(tolerance, measured):
    far = rig_with(virtual={"seed": 5, "parameter_spread": "large"}, tolerances={"current": tolerance})
    true, nominal = far_robot(far).springs, far.spring_parameters()
    assert (true.current_limit == nominal.current_limit) is measured
    assert true.convection_fan != nominal.convection_fan


def at(t: float, fault):
    """Meddle with the board at a time of the schedule."""

    def meddle(virtual: VirtualRig) -> None:
        virtual.clock.call_at(virtual.start + t, lambda _: fault(virtual.emulator.faults))

    return meddle


def test_a_welded_contact_is_opened_by_the_cutoff():
    schedule = compile_schedule(gait(), rig_with(), cycles=1)
    virtual, _ = play(rig_with(), schedule, at(1.0, lambda f: f.welded.add(1)))
    assert virtual.emulator.contacts == (True, False, False, False)
    assert virtual.springs.max_temperature_c < 75
    without = rig_with()
    with VirtualRig(without.model_copy(update={"cutoff": None}), Piston()) as virtual:
        virtual.emulator.faults.welded.add(1)
        virtual.board.send({1: True})
        virtual.clock.sleep_until(30.0)
        virtual.frame(30.0)
        assert virtual.springs.max_temperature_c > 80, "what the cut-off prevents"


@pytest.mark.parametrize(
    ("fault", "error"),
    [
        (lambda f: f.deaf.add(3), ContactError),
        (lambda f: setattr(f, "garbled", True), RelayError),
        (lambda f: setattr(f, "silent", True), RelayError),
    ],
)
def test_a_fault_while_heating_ends_with_everything_off(fault, error):
    schedule = compile_schedule(gait(), rig_with(), cycles=1)
    virtual, notes = play(rig_with(), schedule, at(4.0, fault))
    assert isinstance(notes.error, error)
    assert virtual.emulator.contacts == (False,) * 4
    assert max(e.t for e in virtual.emulator.contact_events) - virtual.start < 15
    assert virtual.springs.max_temperature_c < 90


def test_no_specimen_passes_the_ceiling_even_with_a_welded_contact():
    """Full pulses of the longest length, then one held until the cut-off acts, for springs of 300 rigs."""
    rig, rng = rig_with(), np.random.default_rng(2)
    nominal, tolerances = rig.spring_parameters(), rig.spring_tolerances()
    specimens = [tolerances.perturb(nominal, rng).perturb(rng) for _ in range(300)]
    steps = round(20 / STEP)
    times = np.tile(np.arange(steps) * STEP, 3)
    on = times < rig.limits.max_on_s - 1e-9
    on[-steps:] = times[-steps:] < rig.cutoff.max_on_s
    peak = heat(on[:, None].repeat(300, axis=1), STEP, specimens).temperature.max()
    assert 70 < peak < rig.limits.max_temperature_c


def test_the_springs_of_a_rig_have_the_errors_of_its_seed_in_common():
    """Own deviations are at most 2 K and 8 % about what the rig of the seed has in common."""
    rig = rig_with()
    for seed in (1, 2, 3):
        other = rig.model_copy(update={"virtual": rig.virtual.model_copy(update={"seed": seed})})
        common = rig.spring_tolerances().perturb_by_seed(rig.spring_parameters(), seed)
        springs = VirtualRig(other, Piston()).springs.parameters
        assert {(s.current_limit, s.ambient) for s in springs} == {(common.current_limit, common.ambient)}
        assert common.current_limit != rig.spring_parameters().current_limit
        for spring in springs:
            assert abs(spring.austenite_finish - common.austenite_finish) <= 2.0
            assert abs(spring.convection_fan / common.convection_fan - 1) <= 0.08 + 1e-12


def test_an_unplugged_board_is_told_at_once():
    schedule = compile_schedule(gait(), rig_with(), cycles=1)
    virtual, notes = play(
        rig_with(),
        schedule,
        lambda v: v.clock.call_at(v.start + 5.0, lambda _: v.emulator.unplug()),
    )
    assert isinstance(notes.error, RelayError)
    assert "cut the heating supply" in str(notes.error)
    assert virtual.clock.now() - virtual.start < 6
    assert virtual.emulator.contacts == (False,) * 4


def test_the_player_refuses_what_the_limits_refuse():
    with VirtualRig(rig_with(), Piston()) as virtual:
        with raises(EldirError, "limit.stuck-contact"):
            PulseController(virtual.board, rig_with(cutoff=None), virtual.clock)
        assert virtual.emulator.contact_events == []


def test_a_virtual_clock_does_what_is_due_in_order():
    clock, done = VirtualClock(), []
    clock.call_at(2.0, done.append)
    clock.call_at(1.0, lambda t: clock.call_at(1.5, done.append))
    clock.sleep_until(1.7)
    assert done == [1.5] and clock.now() == 1.7
    clock.sleep_until(1.0)
    assert clock.now() == 1.7, "never back"
    clock.sleep_until(3.0)
    assert done == [1.5, 2.0]
