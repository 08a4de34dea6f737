"""The page in a real browser, beside real programs: what it shows, and that its Stop opens every contact."""

import json
import os
import signal
import time

import numpy as np
import pytest

from eldir.errors import InputError
from eldir_app import emergency_stop
from eldir_app.emergency_stop import run_off
from eldir_hardware.log.reader import read_log
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.safety.latch import read_stop
from tests.app.watch.bench import again_where_busy, free_port, heating, post, virtual_run, watching
from tests.app.watch.browser import browser
from tests.hardware.emulated_rigs import rig_file, wait
from tests.hardware.log.log_contents import picture
from tests.hardware.rigs_and_schedules import RIG, SCHEDULE
from tests.hardware.run.faults import guardian_of
from tests.raised import raises

WITHIN = 0.5
"""From the click until every contact is open [s]."""
INK = """(() => {
  const canvas = document.getElementById("curves"), pen = canvas.getContext("2d");
  const data = pen.getImageData(0, 0, canvas.width, canvas.height).data;
  let blue = 0;
  for (let i = 0; i < data.length; i += 4) blue += data[i] < 40 && data[i + 1] > 80 && data[i + 2] > 140;
  return blue;
})()"""
"""Pixels in the colour of the first spring."""


@pytest.fixture(scope="module")
def page():
    with browser() as opened:
        yield opened


@pytest.fixture
def finished_log(tmp_path):
    path = tmp_path / "finished.mcap"
    with Recorder(path, [f"channel{i}" for i in range(1, 5)], _springs()) as log:
        log.attach("rig.yaml", RIG.source or _text())
        log.attach("schedule.json", json.dumps(SCHEDULE.to_json()).encode())
        for number in range(200):
            t = number / 10
            log.on_frame(t, picture(number))
            log.on_relays(t, [5 < t < 9, False, False, False])
            log.on_temperatures(t, [22 + t, 22, 23, 24])
        log.on_status(20.0, "player", "channel 1 did not switch", good=False)
    return path


def _springs():
    return [f"spring{c.spring}_{c.face}" for c in RIG.channels]


def _text():
    return json.dumps(RIG.to_json()).encode()


def test_a_finished_log_is_replayed(page, finished_log):
    with watching("--log", finished_log) as (address, _):
        page.size(1400, 900)
        page.open(address)
        page.wait("document.getElementById('mode').innerText.includes('Replay of finished.mcap')")
        page.wait("document.getElementById('events').innerText.includes('channel 1 did not switch')")
        assert page.place("#stop")["width"] == 0  # it would stop nothing of this log
        page.wait("document.getElementById('picture-note').innerText == 'at 0.0 s'")  # not the last picture
        slide = "(() => { const i = document.getElementById('instant'); i.value = %s; i.oninput(); })()"
        page.ask(slide % 12)
        page.wait("document.getElementById('picture-note').innerText == 'at 12.0 s'")
        page.wait("document.getElementById('legend').innerText.includes('34.0 °C')")
        assert page.ask(INK) > 500
        _check_walk_in_words(page)
        assert not page.errors


def _check_walk_in_words(page):
    """What the page says of markers and prediction at an instant of a run with a pause of five seconds."""
    schedule = {"settle_s": 1, "period_s": 10, "cycles": 2, "conditioning_cycles": 1}
    rows = [[11, 0, 0, 0], [16, 0.4, 0.1, 0.7], [21, -0.2, -0.5, 0.1], [31, 1, 0.5, 1.5]]
    run = {"marks": [[20, 0.3]], "begins": [[15, 1, 16]], "prediction": rows, "replay": True}

    def words(now, **changes):
        values = ", ".join(map(json.dumps, (run | changes, schedule, now)))
        return page.ask(f"import('/walk.js').then((walk) => walk.describeWalk({values}))")

    end = "in the whole run +1.00 (+0.50 to +1.50): mean, and the interval for 95 % of such robots"
    assert words(23.5) == f"Walked +0.30 body lengths\nPredicted by now +0.10 (−0.20 to +0.40), {end}"
    assert words(40) == f"Walked +0.30 body lengths\nPredicted {end}"
    assert words(23.5, tracked_share=0.4, prediction="computing").startswith("Finding markers, 40 %\n")
    assert words(19, tracked_share=0.4, marks=[[19, None]]).endswith(f"{end}")
    assert words(5, marks=[]) == "Predicted from the first cycle that counts on"
    assert words(5, marks=[], prediction=None) == ""


def test_the_page_turns_to_the_run_that_begins_and_its_curves_move(page, tmp_path):
    virtual = tmp_path / "virtual.yaml"
    with virtual_run(tmp_path) as player, watching("--rig", virtual) as (address, _):
        page.size(1400, 900)
        page.open(address)
        page.wait("document.getElementById('mode').innerText == 'Running: virtual.mcap'")
        page.wait("Number(document.getElementById('legend').innerText.match(/ch 1: ([0-9.]+)/)?.[1]) > 26")
        before = page.ask(INK)
        page.wait("Number(document.getElementById('legend').innerText.match(/ch 1: ([0-9.]+)/)?.[1]) > 31")
        assert page.ask(INK) > before > 0
        ages = [float(page.text("run").split("Data\n")[1].split(" s old")[0]) for _ in range(20)]
        assert np.median(ages) < 0.3 and page.ask("document.getElementById('alarm').hidden")
        assert post(address.removeprefix("http://").strip("/"), "/stop")[1]["proven"], "another browser stops"
        assert player.wait(10.0) == 1  # its emulated board goes with it
        page.wait("document.getElementById('alarm').innerText.startsWith('The run ended at ')")
        assert "stopped by SIGTERM" in page.text("alarm") and page.ask(
            "document.getElementById('outcome').hidden"
        )
        ended_at = page.text("run").split("Time\n")[1].split("\n")[0]
        assert ended_at.startswith("ended at ") and "when the run ended" in page.text("heat-note")
        page.wait("document.documentElement.dataset.over == 'true'")
        time.sleep(0.6)
        assert ended_at in page.text("run"), "its clock stands"
        assert not page.errors
    _, _, ended = read_log(tmp_path / "virtual.mcap").statuses[-1]
    assert ended.startswith("stopped by SIGTERM") and "all contacts are open by the board's report" in ended


def test_a_run_in_virtual_time_is_shown_and_stopped(page, tmp_path):
    """As `eldir rig new --board virtual` writes the rig file: the run has neither a port nor a guardian."""
    virtual = tmp_path / "virtual.yaml"
    with virtual_run(tmp_path, "virtual", 100_000) as player, watching("--rig", virtual) as (address, _):
        page.size(1400, 900)
        page.open(address)
        page.wait("document.getElementById('mode').innerText == 'Running: virtual.mcap'")
        page.wait("document.getElementById('rig').innerText.includes('virtual time: nothing is heated')")
        page.wait("Number(document.getElementById('legend').innerText.match(/ch 1: ([0-9.]+)/)?.[1]) > 26")
        page.click("#pause")
        page.wait("document.getElementById('mode').innerText == 'Paused: virtual.mcap'")
        before = (tmp_path / "virtual.mcap").stat().st_size
        time.sleep(1.0)
        grown = (tmp_path / "virtual.mcap").stat().st_size - before
        assert grown < 100_000, "a second of the person is a second of the run, not minutes"
        page.click("#stop")
        assert player.wait(10.0) == 1
        page.wait("document.getElementById('outcome').innerText.startsWith('Stopped after')")
        assert "virtual.mcap: the run was ended" in page.text("outcome")
        page.wait("document.getElementById('mode').innerText == 'Ended: virtual.mcap'")
        page.click("#stop")  # nothing plays now
        page.wait("document.getElementById('outcome').innerText.includes('nothing was switched off')")
    assert read_log(tmp_path / "virtual.mcap").statuses[-1][2].startswith("stopped by SIGTERM")


@pytest.mark.parametrize("clock", ["virtual", "wall"])
def test_rig_off_ends_the_run_of_a_virtual_rig(clock, tmp_path, capfd, monkeypatch):
    with virtual_run(tmp_path, clock, 100_000 if clock == "virtual" else 5) as player:
        log = tmp_path / "virtual.mcap"
        assert wait(lambda: log.exists() and log.stat().st_size > 10_000, 20.0)
        if clock == "virtual":
            with monkeypatch.context() as patched, raises(InputError, "rig.virtual", match="virtual.mcap"):
                # The boards that other tests drive meanwhile are left alone.
                patched.setattr(emergency_stop, "find_off_targets", lambda *_: ([], []))
                run_off(None, None, None)
        assert run_off(tmp_path / "virtual.yaml", None, None) == 0
        assert player.wait(10.0) == 1
    told = capfd.readouterr().out
    assert ("virtual.mcap: the run was ended" if clock == "virtual" else "open by the board's report") in told
    assert "eldir rig reset" not in told, "nothing stays latched"
    with pytest.raises(InputError, match="no program drives the virtual rig"):
        run_off(tmp_path / "virtual.yaml", None, None)


def test_the_stop_is_in_view_at_every_size_and_place(page, tmp_path):
    rig = rig_file(tmp_path / "rig.yaml", "lcus", "/dev/no-board")
    with watching("--rig", rig) as (address, _):
        page.open(address)
        page.wait("document.getElementById('mode').innerText.includes('No schedule is played')")
        for width, height in ((1400, 900), (390, 844), (320, 480), (844, 390)):
            page.size(width, height)
            for scrolled in (0, 10_000):
                page.ask(f"scrollTo(0, {scrolled})")
                box = page.place("#stop")
                assert box["width"] >= 0.4 * min(width, 680) and box["height"] >= 48
                assert box["x"] >= 0 and box["x"] + box["width"] <= width
                assert box["y"] >= 0 and box["y"] + box["height"] <= height
            assert page.ask("document.documentElement.scrollWidth") <= width


@pytest.mark.parametrize(("how", "player"), [("click", "plays"), ("space", "suspended")])
@again_where_busy
def test_the_stop_opens_every_contact(how, player, page, tmp_path):
    with heating(tmp_path / "run") as run, watching("--rig", run.rig) as (address, _):
        page.size(390, 844)
        page.open(address)
        page.wait("document.getElementById('mode').innerText == 'Running: log.mcap'")
        assert wait(lambda: any(run.board.contacts))
        if player == "suspended":  # with its guardian, which would open the contacts
            for process in (guardian_of(run.board), run.player.pid):
                os.kill(process, signal.SIGSTOP)
            page.wait("document.getElementById('alarm').innerText.startsWith('No new data')")
            page.wait("document.getElementById('rig').innerText.split('suspended').length == 3")
            assert any(run.board.contacts)
        begun = page.click("#stop") if how == "click" else page.space()
        after = run.stopped_after(begun)
        print(f"\n{how}, program {player}: off after {after:.2f} s")
        assert after < WITHIN
        page.wait("document.getElementById('outcome').innerText.startsWith('Stopped after')")
        assert "stopped by eldir rig off" in read_stop(run.board.port)
        page.wait("document.getElementById('rig').innerText.includes('stopped by eldir rig off')")
        page.wait(
            "document.getElementById('alarm').innerText.includes('Nothing heats before eldir rig reset')"
        )


@again_where_busy
def test_a_stop_is_told_on_the_pages_of_others(page, tmp_path):
    with heating(tmp_path / "run") as run, watching("--rig", run.rig) as (address, _), browser() as other:
        for one in (page, other):
            one.open(address)
            one.wait("document.getElementById('mode').innerText == 'Running: log.mcap'")
        assert other.ask("document.getElementById('alarm').hidden")
        page.click("#stop")
        assert run.player.wait(5.0) == 1
        other.wait("document.getElementById('alarm').innerText.includes('Nothing heats before')")
        other.wait("document.getElementById('mode').innerText == 'Ended: log.mcap'")
        assert other.text("outcome") == "", "nobody pressed Stop there"
        assert "ended at" in other.text("run"), "its clock stands still"


@again_where_busy
def test_a_run_is_paused_and_finished_from_the_page(page, tmp_path):
    with heating(tmp_path / "again") as run, watching("--rig", run.rig) as (address, _):
        page.size(390, 844)
        page.open(address)
        page.wait("!document.getElementById('orders').hidden")
        assert page.ask("document.documentElement.scrollWidth") <= 390
        after = run.stopped_after(page.click("#pause"))
        assert after < WITHIN
        page.wait("document.getElementById('mode').innerText == 'Paused: log.mcap'")
        page.wait("document.getElementById('pause').innerText == 'Resume'")
        page.click("[data-order=finish]")
        assert run.player.wait(5.0) == 0
        assert read_stop(run.board.port) is None, "no stop is latched"
        page.wait("document.getElementById('orders').hidden")
    assert read_log(run.log).statuses[-1][2] == "finished after 0 of 5 cycles"


@again_where_busy
def test_a_server_that_is_killed_says_so_and_one_that_is_back_stops(page, tmp_path):
    port = free_port()
    with heating(tmp_path / "run") as run:
        with watching("--rig", run.rig, port=port) as (address, server):
            page.size(1400, 900)
            page.open(address)
            page.wait("document.getElementById('mode').innerText == 'Running: log.mcap'")
            server.kill()
            page.wait("document.getElementById('alarm').innerText.startsWith('Connection lost')")
            page.click("#stop")
            page.wait("document.getElementById('outcome').innerText.startsWith('NOT STOPPED')")
        assert run.player.poll() is None  # the run does not depend on the page
        with watching("--rig", run.rig, port=port):
            page.wait("document.getElementById('alarm').hidden")
            page.wait("document.getElementById('legend').innerText.split('°C').length == 5")
            assert wait(lambda: any(run.board.contacts))
            after = run.stopped_after(page.click("#stop"))
            page.wait("document.getElementById('outcome').innerText.startsWith('Stopped after')")
            print(f"\nafter a restart: off after {after:.2f} s")
            assert after < WITHIN
