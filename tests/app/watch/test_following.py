"""A log that grows is followed record by record; what the page shows of it is what the log holds."""

import asyncio
import time
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from eldir.errors import InputError
from eldir_app.watch import run_view as viewing
from eldir_app.watch.followed_run import FollowedRun
from eldir_app.watch.marker_tracking import WalkMeter
from eldir_app.watch.run_view import PagePosition, RunView
from eldir_hardware.clock import VirtualClock
from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.log import messages as m
from eldir_hardware.log.background import BackgroundRecorder
from eldir_hardware.log.following import LogFollower
from eldir_hardware.log.reader import read_log
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.run.player import Player
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.log.log_contents import EPOCH, NAMES, POSITIONS, picture
from tests.hardware.rigs_and_schedules import RIG, SCHEDULE
from tests.hardware.virtual.piston_and_observer import Piston

SPRINGS = [f"spring{c.spring}_{c.face}" for c in RIG.channels]
CHANNELS = [f"channel{i}" for i in range(1, 5)]


def write(log, number):
    t = number / 10
    log.on_frame(t, picture(number))
    log.on_tracks(t, NAMES, POSITIONS)
    log.on_relays(t, [number % 7 < 3, False, number % 2 == 0, False])
    log.on_temperatures(t, [22 + t, 30 - t, 25, 26])
    log.on_currents(t, [3.4, float("nan"), 0.0, 0.1], [4.0, 0.0, 0.0, 0.0])


def test_each_record_comes_once_while_the_log_grows(tmp_path):
    path, found = tmp_path / "log.mcap", []
    with Recorder(path, CHANNELS, SPRINGS, EPOCH) as log, LogFollower(path) as follower:
        for number in range(30):
            write(log, number)
            if number % 4 == 0:
                found += follower.poll()
        assert len(found) > 100 and not follower.is_finished and not follower.is_complete
    with LogFollower(path) as whole:
        at_once = list(whole.poll())
        assert whole.is_finished and whole.is_complete and whole.epoch_ns == EPOCH
        pictures = [f for f in at_once if f.topic == m.IMAGE]
        again = [bytes(whole.read(f.place).data) for f in reversed(pictures)]
    assert again[::-1] == [data.tobytes() for _, data in read_log(path).pictures]
    assert [(f.topic, f.stamp_ns) for f in at_once][: len(found)] == [(f.topic, f.stamp_ns) for f in found]


def test_a_record_is_seen_within_a_quarter_of_a_second(tmp_path):
    """Half of them: the computer is busy with other tests."""
    path = tmp_path / "log.mcap"
    topic = m.spring_topic(SPRINGS[-1])
    with BackgroundRecorder(Recorder(path, CHANNELS, SPRINGS, EPOCH)) as log, LogFollower(path) as follower:
        delays = []
        for number in range(9):
            put = time.monotonic()
            log.on_temperatures(number / 100, [22, 22, 22, 22])  # no report follows that would take it along
            while topic not in [f.topic for f in follower.poll()]:
                assert time.monotonic() - put < 15.0
                time.sleep(0.005)
            delays.append(time.monotonic() - put)
    assert np.median(delays) < 0.25


def test_a_log_that_is_cut_off_anywhere_is_followed_up_to_there(tmp_path):
    path, cut = tmp_path / "log.mcap", tmp_path / "cut.mcap"
    with Recorder(path, CHANNELS, SPRINGS, EPOCH) as log:
        for number in range(12):
            write(log, number)
    data = path.read_bytes()
    rng, most = np.random.default_rng(3), 0
    with LogFollower(path) as whole:
        expected = [(f.topic, f.stamp_ns) for f in whole.poll()]
    for end in [*range(20), *rng.integers(20, len(data), 15)]:
        cut.write_bytes(data[:end])
        with LogFollower(cut) as follower:
            found = [(f.topic, f.stamp_ns) for f in follower.poll()]
            assert found == expected[: len(found)]
            cut.write_bytes(data)  # the rest comes
            found += [(f.topic, f.stamp_ns) for f in follower.poll()]
            assert found == expected and follower.is_finished
        most = max(most, len(found))
    assert most == len(expected)


@pytest.mark.parametrize("what", ["missing", "another file", "a folder"])
def test_what_is_no_log_is_refused(what, tmp_path):
    path = tmp_path / "log.mcap"
    if what == "another file":
        path.write_text("no log at all")
    elif what == "a folder":
        path.mkdir()
    with pytest.raises(InputError):
        LogFollower(path).open()


def test_a_damaged_chunk_costs_only_itself(tmp_path):
    path = tmp_path / "log.mcap"
    with Recorder(path, CHANNELS, SPRINGS, EPOCH) as log:
        for number in range(12):
            write(log, number)
    with LogFollower(path) as follower:
        expected = list(follower.poll())
    middle = expected[len(expected) // 2].place.chunk
    data = bytearray(path.read_bytes())
    data[middle + 100] ^= 0xFF
    path.write_bytes(data)
    with LogFollower(path) as follower:
        found = list(follower.poll())
        assert follower.damaged == 1 and follower.is_finished
    assert [f.stamp_ns for f in found] == [f.stamp_ns for f in expected if f.place.chunk != middle]


def shown(path):
    view = RunView(path)
    with LogFollower(path) as follower:
        for followed in follower.poll():
            view.update(followed, follower)
    return view


@pytest.mark.parametrize("with_rig", [True, False])
def test_the_view_holds_what_the_log_holds(with_rig, tmp_path):
    path = tmp_path / "log.mcap"
    with Recorder(path, CHANNELS, SPRINGS, EPOCH) as log:
        if with_rig:
            log.attach("rig.yaml", RIG.model_dump_json().encode())
        for number in range(40):
            write(log, number)
    read, view = read_log(path), shown(path)
    rows = np.array(view.curves["temperatures"].rows)
    order, count = [read.springs.index(s) for s in SPRINGS], len(rows)
    assert count >= 39  # without a rig file the last instant is complete when the next one comes
    np.testing.assert_allclose(rows[:, 0], read.temperature_times[:count], atol=1e-3)
    np.testing.assert_allclose(rows[:, 1:], read.temperatures[:count, order], atol=0.051)
    contacts = np.array(view.curves["contacts"].rows)
    held = contacts[np.searchsorted(contacts[:, 0], read.relay_times + 1e-6) - 1, 1:]
    np.testing.assert_array_equal(held > 0, read.relays)
    assert view.curves["currents"].rows[0] == [0.0, 3.4, None, 0.0, 0.1]
    assert view.camera_rate == pytest.approx(10, abs=0.4)
    assert not with_rig or view.plan["rig"]["max_temperature_c"] == RIG.limits.max_temperature_c


def test_pages_get_each_row_once_also_when_old_rows_are_thinned(tmp_path, monkeypatch):
    monkeypatch.setattr(viewing, "MAX_ROWS", 100)
    view, seen, rows = RunView(tmp_path), PagePosition(), []
    for number in range(333):
        view.curves["temperatures"].add([number, 20.0])
        if number % 10 == 0:
            news, seen = view.news(seen)
            rows = ([] if "anew" in news else rows) + news.get("temperatures", [])
            assert rows == view.curves["temperatures"].rows
    assert rows[0] == [0, 20.0] and len(rows) <= 100
    assert view.news(seen)[0]["temperatures"] == view.curves["temperatures"].rows[len(rows) :]


def test_a_pause_moves_the_schedule_that_is_shown(tmp_path):
    """By the words of the real player."""
    path = tmp_path / "log.mcap"
    plan = replace(SCHEDULE, settle_s=1.0, conditioning_cycles=0, cycles=2)

    class Log(Recorder):
        def on_event(self, t, text):
            self.on_status(t, "player", text)

    with VirtualRig(RIG, Piston()) as virtual, Log(path, CHANNELS, SPRINGS, 0) as log:
        clock: VirtualClock = virtual.clock
        player = Player(PulseController(virtual.board, RIG, clock), plan, RIG, clock, [log])

        def ready(at):
            clock.call_at(at + 24.0, lambda t: player.pause())  # in the second cycle
            clock.call_at(at + 60.0, lambda t: player.resume())

        player.play(0.0, ready)
    view = shown(path)
    ((_, cycle, begin),) = view.curves["begins"].rows
    assert cycle == 1 and not view.paused
    closings = [row[0] for old, row in pairwise(view.curves["contacts"].rows) if row[1] > old[1]]
    assert len(closings) == 3 and closings[-1] == pytest.approx(begin, abs=0.2)


def test_the_walk_is_the_mean_motion_of_the_marks_since_the_cycles_that_count():
    walk = WalkMeter(start=10.0, body_length=0.1)
    here = np.array([[0.0, 0.0], [0.1, 0.0], [np.nan, np.nan]])
    assert walk.update(9.0, here - 5.0) is None
    assert walk.update(10.0, here) == 0.0
    moved = here + np.array([0.02, 0.5])
    moved[2] = [1.0, 0.0]  # seen for the first time
    assert walk.update(11.0, moved) == pytest.approx((0.02 + 0.02 + 0.0) / 3 / 0.1, abs=1e-3)
    assert walk.update(12.0, np.full((3, 2), np.nan)) is None


def test_while_a_log_is_read_in_pieces_the_rest_is_known_to_be_there(tmp_path):
    """Or the page of a run that has just ended would say that its log is not finished."""
    path = tmp_path / "log.mcap"
    with Recorder(path, CHANNELS, SPRINGS, EPOCH) as log:
        for number in range(30_000):
            log.on_temperatures(number / 10, [22.0, 30.0, 25.0, 26.0])

    async def follow() -> list[tuple[bool, bool]]:
        run = FollowedRun(None, path)
        reading, seen = asyncio.create_task(run.run()), []
        while not run.has_ended:
            await run.wait_for_change()
            seen.append((run.is_behind, run.has_ended))
        await asyncio.sleep(0.2)
        seen.append((run.is_behind, run.has_ended))
        reading.cancel()
        return seen

    first, *_, last = asyncio.run(follow())
    assert first == (True, False) and last == (False, True)
