"""Signals that end the program: an exception while it heats, held back while it switches off."""

import io
import signal
import threading
from contextlib import redirect_stderr

import pytest

from eldir.errors import EldirError
from eldir_hardware.safety.stop_signals import StoppedError, StopSignals, signals_as_errors

ENDING = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT]
RAISED = {signal.SIGINT: KeyboardInterrupt} | dict.fromkeys(ENDING[1:], StoppedError)


@pytest.fixture(autouse=True)
def handlers():
    """Whatever a test leaves behind."""
    before = {number: signal.getsignal(number) for number in ENDING}
    yield before
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", ENDING)
def test_a_signal_while_heating_is_an_exception_at_once(number, handlers):
    done = []
    stop = StopSignals()
    with pytest.raises(RAISED[number]) as told, stop.handled(), stop.raising():
        signal.raise_signal(number)
        done.append("heated on")
    assert number == signal.SIGINT or f"stopped by {number.name}" in str(told.value)
    assert not done
    assert {n: signal.getsignal(n) for n in ENDING} == handlers, "handled as before"


@pytest.mark.parametrize("number", ENDING)
def test_a_signal_while_switching_off_is_held_back(number, handlers):
    done = []
    stop = StopSignals()
    with pytest.raises(RAISED[number]), stop.handled():
        signal.raise_signal(number)
        done.append("switched off")
    assert done == ["switched off"]
    assert {n: signal.getsignal(n) for n in ENDING} == handlers


def test_a_signal_before_heating_prevents_it():
    done = []
    stop = StopSignals()
    with pytest.raises(StoppedError), stop.handled():
        signal.raise_signal(signal.SIGTERM)
        with stop.raising():
            done.append("heated")
    assert not done


def test_only_the_first_signal_is_raised():
    """The second comes while everything is switched off, and must not end that."""
    done = []
    stop = StopSignals()
    with pytest.raises(StoppedError, match="SIGTERM"), stop.handled():
        try:
            with stop.raising():
                signal.raise_signal(signal.SIGTERM)
        finally:
            signal.raise_signal(signal.SIGINT)
            done.append("switched off")
    assert done == ["switched off"]


def test_a_second_signal_while_still_heating_is_not_raised_again():
    done = []
    stop = StopSignals()
    with pytest.raises(StoppedError, match="SIGTERM"), stop.handled(), stop.raising():
        try:
            signal.raise_signal(signal.SIGTERM)
        except StoppedError:
            signal.raise_signal(signal.SIGINT)
            done.append("cleared up")
            raise
    assert done == ["cleared up"]


def test_after_heating_a_signal_waits_again():
    done = []
    stop = StopSignals()
    with pytest.raises(KeyboardInterrupt), stop.handled():
        with stop.raising():
            pass
        signal.raise_signal(signal.SIGINT)
        done.append("switched off")
    assert done == ["switched off"]


def test_without_a_signal_nothing_happens(handlers):
    stop = StopSignals()
    with stop.handled(), stop.raising():
        pass
    assert {n: signal.getsignal(n) for n in ENDING} == handlers


def test_an_error_keeps_its_name():
    stop = StopSignals()
    with pytest.raises(ZeroDivisionError), stop.handled(), stop.raising():
        raise ZeroDivisionError


@pytest.mark.parametrize("number", ENDING)
def test_only_a_closed_terminal_may_be_ignored(number):
    """As by nohup. Ctrl-C in a program started with it in the background of a script still ends the heat."""
    done = []
    signal.signal(number, signal.SIG_IGN)
    stop = StopSignals()

    def heat() -> None:
        with stop.handled(), stop.raising():
            signal.raise_signal(number)
            done.append("heated on")

    if number == signal.SIGHUP:
        heat()
        assert done == ["heated on"]
    else:
        with pytest.raises(RAISED[number]):
            heat()
    assert signal.getsignal(number) is signal.SIG_IGN


def test_another_thread_handles_no_signals(handlers):
    found = []

    def run() -> None:
        stop = StopSignals()
        with stop.handled(), stop.raising():
            found.append({n: signal.getsignal(n) for n in ENDING})

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert found == [handlers]


def test_what_a_stop_says():
    error = StoppedError("a key")
    assert error.reason == "a key" and "everything was switched off" in str(error)


def test_the_first_of_two_signals_is_the_cause():
    stop = StopSignals()
    with pytest.raises(StoppedError, match="stopped by SIGTERM"), stop.handled():
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)


class Struck(io.StringIO):
    """A terminal; a signal comes with everything that is printed on it."""

    def write(self, text: str) -> int:
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGTERM)
        return super().write(text)


def test_an_error_is_printed_before_a_signal_can_end_the_program(handlers):
    stop = StopSignals()
    with redirect_stderr(Struck()) as said, pytest.raises(EldirError, match="channel 2"), stop.handled():
        raise EldirError("channel 2 is hot")
    assert said.getvalue() == "eldir: channel 2 is hot\n"
    assert {n: signal.getsignal(n) for n in ENDING} == handlers


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_of_a_command_is_an_error_each_time(number, handlers):
    """So that a log is closed; SIGHUP is ignored where it was, as under nohup."""
    with signals_as_errors():
        for _ in range(2):
            with pytest.raises(EldirError, match=f"^stopped by {number.name}$"):
                signal.raise_signal(number)
    assert {n: signal.getsignal(n) for n in ENDING} == handlers
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with signals_as_errors():
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
