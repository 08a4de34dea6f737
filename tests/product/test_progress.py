"""Progress without a terminal: plain lines, some seconds apart, and nothing for short work."""

import pytest

from eldir_app import progress


class Time:
    def __init__(self) -> None:
        self.now = 0.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Time:
    time = Time()
    monkeypatch.setattr(progress, "time", time)
    return time


def test_a_line_per_stage_and_every_ten_seconds(clock: Time, capsys: pytest.CaptureFixture[str]) -> None:
    with progress.progress_bar(note="fitting: minutes") as shown:
        task = shown.add_task("reading", total=1.0)
        for second in range(40):
            clock.now = float(second)
            stage = "fit" if second > 20 else "reading"
            shown.update(task, description=stage, completed=second / 40)
    told = capsys.readouterr()
    assert told.out == ""
    lines = told.err.splitlines()
    assert lines[0] == "fitting: minutes"
    assert lines[1:] == [
        "reading: 5 % (2 s, about 38 s left)",
        "reading: 30 % (12 s, about 28 s left)",
        "fit: 52 % (21 s, about 19 s left)",
        "fit: 78 % (31 s, about 9 s left)",
    ]
    assert "\x1b" not in told.err and "\r" not in told.err


def test_the_time_left_of_a_step_counts_from_its_begin(
    clock: Time, capsys: pytest.CaptureFixture[str]
) -> None:
    """An identification fits several models one after the other: no hours are left of the last one."""
    with progress.progress_bar() as shown:
        task = shown.add_task("starts", total=1.0)
        for second in range(1000):
            clock.now = float(second)
            shown.update(task, description="starts", completed=second / 1000)
        for second in range(11):
            clock.now = 1000.0 + second
            shown.update(task, description="fit", completed=0.1 + second / 20)
    assert capsys.readouterr().err.splitlines()[-1] == "fit: 60 % (1010 s, about 8 s left of this step)"


def test_a_run_that_begins_before_its_zero_has_one_step(
    clock: Time, capsys: pytest.CaptureFixture[str]
) -> None:
    with progress.progress_bar() as shown:
        task = shown.add_task("driving", total=100.0)
        for second in range(13):
            clock.now = float(second)
            shown.update(task, completed=second - 0.5)
    assert capsys.readouterr().err.splitlines()[-1] == "driving: 12 % (12 s, about 92 s left)"


def test_a_stage_that_is_over_is_not_told_again(clock: Time, capsys: pytest.CaptureFixture[str]) -> None:
    with progress.progress_bar() as shown:
        show = progress.show_stages(shown)
        for second, stage in enumerate(["evolving", "choosing", "driving", "tracking"]):
            for tenth in range(50):
                clock.now = 5.0 * second + tenth / 10
                show(stage, tenth / 50)
    told = [line.split(":")[0] for line in capsys.readouterr().err.splitlines()]
    assert told == ["evolving", "choosing", "driving", "tracking"]
    assert [task.completed for task in shown.tasks] == [1.0, 1.0, 1.0, 49 / 50]


def test_short_work_says_nothing(clock: Time, capsys: pytest.CaptureFixture[str]) -> None:
    with progress.progress_bar() as shown:
        task = shown.add_task("driving", total=None)
        for tenth in range(20):
            clock.now = tenth / 10
            shown.update(task, completed=tenth)
    assert capsys.readouterr().err == ""
