"""A schedule started from the page: with the option and the token alone, and never beside a latched stop."""

import pytest
from typer.testing import CliRunner

from eldir_app.commands.rig import rig as command
from eldir_app.watch.access import load_token
from tests.app.watch.bench import post, save_schedule, watching
from tests.app.watch.browser import browser
from tests.hardware.emulated_rigs import emulated, rig_file, wait


def test_a_start_needs_the_option_the_token_and_no_latched_stop(tmp_path):
    with emulated("lcus") as board:
        rig = rig_file(tmp_path / "rig.yaml", "lcus", board.port)
        save_schedule(rig, tmp_path / "schedule.json")
        with watching("--rig", rig) as (address, _):
            host = address.removeprefix("http://").strip("/")
            assert post(host, "/start")[0] == 401 and post(host, "/start", load_token())[0] == 401
        with watching("--rig", rig, "--allow-start", tmp_path / "schedule.json") as (address, server):
            host = address.removeprefix("http://").strip("/")
            token = load_token()
            assert post(host, "/start")[0] == 401
            assert post(host, "/start", token[:-1])[0] == 401
            assert post(host, "/start", token, "http://evil.example")[0] == 403
            with browser() as page:  # one press arms the button, the second one asks for the token
                page.open(address)
                page.wait("document.getElementById('start').textContent == 'Start schedule.json'")
                page.click("#start")
                page.wait("document.getElementById('start').textContent == 'Press again to heat'")
                assert page.ask("document.getElementById('entry').hidden")
                page.click("#start")
                page.wait("!document.getElementById('entry').hidden")
                page.wait("document.getElementById('start').textContent == 'Start schedule.json'")
            assert not board.contact_events
            assert post(host, "/start", token) == (200, {"taken": True, "text": ""})
            assert wait(lambda: any(board.contacts), 25.0)
            status, said = post(host, "/start", token)
            assert status == 409 and said["text"].startswith("a rig is being driven already")
            assert post(host, "/stop")[1]["proven"]
            assert not any(board.contacts)
            switched = len(board.contact_events)
            assert wait(lambda: "is stopped" in post(host, "/start", token)[1]["text"])
            assert len(board.contact_events) == switched
            server.stdout.close()
        assert len(list(tmp_path.glob("schedule-*.mcap"))) == 1
        assert "stopped by" in next(tmp_path.glob("schedule-*.txt")).read_text()


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["--allow-start", "schedule.json"], "--allow-start needs --rig"),
        (["--allow-start", "missing.json", "--rig", "rig.yaml"], "missing.json"),
        (["--allow-start", "rig.yaml", "--rig", "rig.yaml"], "rig.yaml"),
    ],
)
def test_what_cannot_be_started_is_refused_at_once(words, problem, tmp_path):
    rig_file(tmp_path / "rig.yaml", "lcus", "/dev/no-board")
    words = [str(tmp_path / w) if "." in w else w for w in words]
    found = CliRunner().invoke(command, ["watch", "--listen", "127.0.0.1:0", *words])
    assert found.exit_code != 0 and problem in str(found.exception)
